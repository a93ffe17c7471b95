//! Memory: how much there is, and how much a task needs at least.

use crate::task::Task;
use photocurrent_core::Grain;

/// Half of what the machine has free, and 4 GiB where it does not say.
pub(crate) fn default_memory() -> u64 {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"));
    let kilobytes = line.and_then(|line| line.trim().trim_end_matches("kB").trim().parse::<u64>().ok());
    kilobytes.map_or(4 << 30, |kilobytes| kilobytes * 1024 / 2)
}

/// All memory that this process may ever have: the machine's, or less where a control group says so. `None`
/// when neither is known.
pub fn machine_memory() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"));
    let total = line
        .and_then(|line| line.trim().trim_end_matches("kB").trim().parse::<u64>().ok())
        .map(|kilobytes| kilobytes * 1024);
    let limits = ["/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"];
    let limits =
        limits.iter().filter_map(|path| std::fs::read_to_string(path).ok()?.trim().parse::<u64>().ok());
    limits.chain(total).min()
}

/// About how many bytes the outputs of a task's smallest piece take: a row where the node may be cut, else
/// everything.
pub(crate) fn least_bytes(task: &Task) -> u64 {
    let all: u64 = task.stored().map(|output| output.meta.estimated_bytes()).fold(0, u64::saturating_add);
    let rows = task.stored().next().and_then(|output| output.meta.rows());
    let same_rows = task.stored().all(|output| output.meta.rows() == rows);
    match (task.grain, rows) {
        (Grain::Pixel | Grain::Row { .. }, Some(rows))
            if same_rows && task.export.is_none() && !rows.is_empty() =>
        {
            all / rows.len() as u64
        }
        _ => all,
    }
}

/// What to do about a plan that is too large.
pub(crate) const LESS: &str = "make less of it: a shorter part of the recording, blocks of time \
                               (`pipeline.blocks`), a lower `rate`, fewer pixels; \
                    or allow more with --memory, where the machine has it";

/// A number of bytes for people: `1.2 GB`.
pub(crate) fn size(bytes: u64) -> String {
    match bytes as f64 {
        bytes if bytes < 1e6 => format!("{:.1} kB", bytes * 1e-3),
        bytes if bytes < 1e9 => format!("{:.1} MB", bytes * 1e-6),
        bytes => format!("{:.1} GB", bytes * 1e-9),
    }
}

//! The photocurrent command; what it does is in `lib.rs`.

use std::process::ExitCode;

/// Blocks of a hundred megabytes that come and go are mapped anew each time by the system's allocator: a
/// fifth of the time of a diagnosis.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Without huge pages for the allocator's blocks, which it takes and gives back every second: the kernel
/// clears 2 MiB where a few pages are touched, 5 % of the processor time of a map solve that is rendered
/// (docs/performance.md).
#[cfg(target_os = "linux")]
fn without_huge_pages() {
    // SAFETY: it takes numbers alone. Where it is refused, nothing changes.
    unsafe { libc::prctl(libc::PR_SET_THP_DISABLE, 1, 0, 0, 0) };
}

fn main() -> ExitCode {
    #[cfg(target_os = "linux")]
    without_huge_pages();
    ExitCode::from(photocurrent_cli::run(std::env::args_os()))
}

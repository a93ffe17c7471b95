//! `photocurrent cache`: what is kept, how much room it takes, what may go, whether it is whole. Packs are in
//! `pack` and `unpack`.

use crate::args::{CacheCommand, CacheOptions};
use crate::failure::{Done, Failure};
use crate::numbers::{human_bytes, human_seconds};
use crate::tables::draw;
use crate::terminal::{print, print_json};
use photocurrent_store::{Cache, GcOptions};
use serde_json::json;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Runs one of the cache's commands.
pub fn cache(options: &CacheOptions) -> Done {
    match &options.command {
        CacheCommand::Ls => ls(existing(options)?),
        CacheCommand::Du => du(existing(options)?),
        CacheCommand::Gc { older_than, max_size, dry_run } => {
            gc(existing(options)?, *older_than, *max_size, *dry_run)
        }
        CacheCommand::Verify => verify(existing(options)?),
        CacheCommand::Pack(pack) => crate::pack::pack(pack, &options.cache, options.json),
        CacheCommand::Unpack(unpack) => crate::unpack::unpack(unpack, &options.cache, options.json),
    }
}

/// Refuses a cache that is not there.
fn existing(options: &CacheOptions) -> Result<&CacheOptions, Failure> {
    if options.cache.is_dir() {
        return Ok(options);
    }
    Err(Failure::Other {
        message: format!(
            "there is no cache at {}; `photocurrent run` makes one, --cache names another",
            options.cache.display()
        ),
        code: 2,
    })
}

fn now_unix_s() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map(|age| age.as_secs()).unwrap_or(0)
}

fn ls(options: &CacheOptions) -> Done {
    let listings = Cache::open(&options.cache)?.ls()?;
    if options.json {
        let of = |l: &photocurrent_store::Listing| {
            json!({
                "key": l.key, "kind": l.kind, "bytes": l.bytes, "seconds": l.seconds,
                "created_unix_s": l.created_unix_s, "used_unix_s": l.used_unix_s, "outputs": l.outputs,
            })
        };
        print_json(&listings.iter().map(of).collect())?;
        return Ok(0);
    }
    let now = now_unix_s();
    let head = ["key", "kind", "size", "took", "last used"].map(String::from).to_vec();
    let rows = listings.iter().map(|l| {
        vec![
            l.key.short(),
            l.kind.clone(),
            human_bytes(l.bytes),
            human_seconds(l.seconds),
            format!("{} ago", human_seconds(now.saturating_sub(l.used_unix_s) as f64)),
        ]
    });
    print(&draw(&std::iter::once(head).chain(rows).collect::<Vec<_>>()))?;
    Ok(0)
}

fn du(options: &CacheOptions) -> Done {
    let used = Cache::open(&options.cache)?.du()?;
    if options.json {
        print_json(&json!({
            "records": used.records, "contents": used.contents, "content_bytes": used.content_bytes,
            "unreferenced_bytes": used.unreferenced_bytes, "temporary_bytes": used.temporary_bytes,
        }))?;
    } else {
        print(&format!(
            "{} in {} contents, named by {} records\n{} of it named by no record (cache gc removes it)\n{} \
             temporary\n",
            human_bytes(used.content_bytes),
            used.contents,
            used.records,
            human_bytes(used.unreferenced_bytes),
            human_bytes(used.temporary_bytes)
        ))?;
    }
    Ok(0)
}

fn gc(options: &CacheOptions, older_than_days: Option<u64>, max_bytes: Option<u64>, dry_run: bool) -> Done {
    let older_than = older_than_days.map(|days| Duration::from_secs(days.saturating_mul(86_400)));
    let report =
        Cache::gc(&options.cache, &GcOptions { max_bytes, older_than, dry_run, ..GcOptions::default() })?;
    if options.json {
        print_json(&json!({
            "dry_run": dry_run, "records": report.records, "contents": report.contents,
            "freed_bytes": report.freed_bytes, "kept_bytes": report.kept_bytes,
        }))?;
    } else {
        let verb = if dry_run { "would remove" } else { "removed" };
        print(&format!(
            "{verb} {} records and {} contents, {}; {} stay\n",
            report.records,
            report.contents,
            human_bytes(report.freed_bytes),
            human_bytes(report.kept_bytes)
        ))?;
    }
    Ok(0)
}

fn verify(options: &CacheOptions) -> Done {
    let report = Cache::open(&options.cache)?.verify()?;
    if options.json {
        print_json(&json!({
            "good_records": report.good_records, "good_contents": report.good_contents,
            "damaged": report.damaged, "orphans": report.orphans,
        }))?;
    } else {
        let mut text =
            format!("{} records and {} contents are whole\n", report.good_records, report.good_contents);
        report.damaged.iter().for_each(|damage| text.push_str(&format!("damaged: {damage}\n")));
        report
            .orphans
            .iter()
            .for_each(|path| text.push_str(&format!("named by no record: {}\n", path.display())));
        print(&text)?;
    }
    // A damaged entry is a miss for the next run; here it is a finding.
    Ok(if report.damaged.is_empty() { 0 } else { 3 })
}

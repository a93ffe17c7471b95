//! MCAP files, as ROS 2 records them (and Foxglove): the messages of [`crate::rosbag`], in either serialisation of ROS. See [`crate::ros`].
//!
//! A folder of `ros2 bag record` is read through its MCAP file. The older storage of ROS 2 bags, SQLite (`.db3`), is recognised and refused.

use crate::declared::Declared;
use crate::error::FormatError;
use crate::format::{Format, Probe};
use crate::recording::Recording;
use crate::ros::{mcap, recording};
use std::path::Path;

/// MCAP.
pub static FORMAT: Format = Format { id: "mcap", name: "MCAP", recognises, open };

/// Is it an MCAP file, or a bag of ROS 2 in a folder or in SQLite?
fn recognises(probe: &Probe) -> bool {
    let names = probe.names.as_deref().unwrap_or_default();
    let of_bag = |name: &String| name.ends_with(".mcap") || name.ends_with(".db3");
    probe.head.starts_with(mcap::MAGIC) || is_sqlite_bag(&probe.head) || probe.has("metadata.yaml") && names.iter().any(of_bag)
}

/// A database with the tables of a ROS 2 bag: their definitions stand on its first page.
fn is_sqlite_bag(head: &[u8]) -> bool {
    const TABLE: &[u8] = b"CREATE TABLE messages(";
    head.starts_with(b"SQLite format 3\0") && head.windows(TABLE.len()).any(|window| window == TABLE)
}

fn open(path: &Path, declared: &Declared) -> Result<Box<dyn Recording>, FormatError> {
    let probe = Probe::new(path)?;
    let sqlite = |path: &Path| {
        let hint = "bring it to MCAP with `ros2 bag convert -i BAG -o out.yaml`, where out.yaml has `output_bags: [{uri: converted, storage_id: mcap}]`";
        FormatError::new(path, "this bag of ROS 2 is stored in SQLite, which is not read", hint).expected("MCAP")
    };
    let Some(names) = &probe.names else {
        if is_sqlite_bag(&probe.head) {
            return Err(sqlite(path));
        }
        return recording::open(mcap::open(path)?, declared);
    };
    let parts: Vec<&String> = names.iter().filter(|name| name.ends_with(".mcap")).collect();
    match parts.as_slice() {
        [] => Err(sqlite(path)),
        [only] => recording::open(mcap::open(&path.join(only))?, declared),
        [first, ..] => {
            let found = format!("the bag is split into {} files", parts.len());
            Err(FormatError::new(path, found, format!("name one of them, as {first}, or join them with `mcap merge`")))
        }
    }
}

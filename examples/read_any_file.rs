//! Counts the events and frames of a recording of any format: `cargo run --example read_any_file -- FILE`.
#![allow(clippy::print_stdout)]

use photocurrent_formats::{Declared, EventChunk, joined, recognise};
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path =
        PathBuf::from(std::env::args().nth(1).unwrap_or("data/recordings/davis346_traffic.aedat4".into()));
    let format = recognise(&path)?.ok_or("a file of no format that is known")?;
    let recording = joined::open(format, &path, &Declared::default())?;
    let (mut cursor, mut chunk, mut events) = (recording.events()?, EventChunk::default(), 0);
    while cursor.next(&mut chunk)? {
        events += chunk.len();
    }
    let frames = recording.pictures().map_or(0, |pictures| pictures.about().stamps.len());
    println!("{}: {}, {events} events, {frames} frames", path.display(), format.name);
    Ok(())
}

//! Estimates of some pixels of a recording: what the solution of the whole has there.
//!
//! Pixels are solved alone, with the settings of their block of rows, so only blocks that have such pixels
//! are read, each by itself. Where effects mix the
//! photocurrent of neighbours or couple all pixels, every row within reach is solved on the way.

use crate::host::Host;
use crate::model::{Model, late_description};
use crate::neighbours;
use crate::options::SolveOptions;
use crate::recording::{Reader, Recording};
use crate::row_solver::RowSolver;
use crate::settings::{BLOCK_ROWS, COMPANY_ROWS, Settings};
use crate::track::PixelTrack;
use photocurrent_core::{NodeError, Rows};
use rayon::prelude::*;

/// The MAP estimates of some values of the frames: `pixels` are numbers `y * width + x`, rising, with as many
/// values a row as a frame has. One track for each
/// in their order, the same bits as [`crate::solve`] gives; empty for a pixel without any frame value.
///
/// # Errors
/// As [`crate::solve_rows`].
///
/// # Panics
/// When a pixel lies outside of the frames.
pub fn solve_pixels(
    recording: &Recording<'_>,
    options: &SolveOptions,
    pixels: &[u32],
    host: &dyn Host,
) -> Result<Vec<PixelTrack>, NodeError> {
    options.check()?;
    let meta = options.tracks_meta(&recording.events.meta, &recording.frames.meta)?;
    let mut model = Model::of_map(options, recording.sensor, &recording.events.meta)?;
    model.inform(recording.events)?;
    let reader = Reader::new(recording, &meta)?;
    let width = reader.wide.extent.width;
    let mixed = neighbours::halo(&model, reader.colours.lie);
    let of_rows: Vec<&[u32]> = pixels.chunk_by(|a, b| a / width == b / width).collect();
    let is_together =
        |a: &&[u32], b: &&[u32]| mixed.is_some() || a[0] / width / BLOCK_ROWS == b[0] / width / BLOCK_ROWS;
    let parts: Vec<&[&[u32]]> = of_rows.chunk_by(is_together).collect();
    let of_part = |part: &&[&[u32]]| -> Result<Vec<Vec<PixelTrack>>, NodeError> {
        let rows = Rows { start: part[0][0] / width, end: part[part.len() - 1][0] / width + 1 };
        let at_hand = match mixed {
            Some(halo) => rows.with_halo(halo, reader.all),
            None => Settings::blocks_of(rows, reader.all).with_halo(COMPANY_ROWS, reader.all),
        };
        if !recording.events.rows().contains(reader.colours.lie.event_rows(at_hand)) {
            return Err(late_description("pixels need the events of their block of rows"));
        }
        let read = reader.read(at_hand)?;
        let recorded = reader.recorded(&read);
        let known = neighbours::known(options, &model, &recorded, rows, host)?;
        let settings = Settings::choose_once(options, &model, &recorded, rows, known.as_ref(), host)?;
        let of_row = |solver: &mut RowSolver, pixels: &&[u32]| {
            let row = pixels[0] / width;
            let columns: Vec<usize> = pixels.iter().map(|pixel| (pixel % width) as usize).collect();
            let tracks = solver.some(&model, settings.of(row), &recorded, row, &columns, known.as_ref())?;
            host.advance(1)?;
            Ok(tracks)
        };
        part.par_iter().map_init(RowSolver::default, of_row).collect()
    };
    let solved: Result<Vec<Vec<Vec<PixelTrack>>>, NodeError> = parts.par_iter().map(of_part).collect();
    Ok(solved?.into_iter().flatten().flatten().collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::solve;
    use photocurrent_core::document::Source;
    use photocurrent_core::events::{Event, Polarity};
    use photocurrent_core::{EventStream, Exposure, Extent, FrameSequence, Sensor, testing};

    /// Log light of a pixel: two sines that move to the right.
    fn log_light(x: u32, y: u32, t_ns: i64) -> f64 {
        let at = 0.5 * f64::from(x) + 0.2 * f64::from(y) - t_ns as f64 * 4e-7;
        4.0 + 0.6 * libm::sin(at) + 0.2 * libm::sin(2.3 * at + 1.0)
    }

    /// A recording of 24 x 34 pixels and 40 ms: events where the log light has moved by 0.2, frames that
    /// collect it; one pixel has no frame.
    fn recorded(sensor: &str) -> (EventStream, FrameSequence, Sensor) {
        let (extent, step_ns, end_ns) = (Extent { width: 24, height: 34 }, 100_000, 40_000_000);
        let mut events = Vec::new();
        for (x, y) in (0..extent.height).flat_map(|y| (0..extent.width).map(move |x| (x, y))) {
            let mut reference = log_light(x, y, 0);
            for t in (0..end_ns).step_by(step_ns as usize) {
                let moved = log_light(x, y, t) - reference;
                if moved.abs() >= 0.2 {
                    let polarity = if moved > 0.0 { Polarity::On } else { Polarity::Off };
                    events.push(Event { x: x as u16, y: y as u16, polarity, t, t_in: Some(t) });
                    reference = log_light(x, y, t);
                }
            }
        }
        let exposures: Vec<Exposure> =
            (0..5).map(|l| Exposure::new(l * 8_000_000, l * 8_000_000 + 4_000_000)).collect();
        let frames = testing::captured(extent, exposures.clone(), 0, |l, x, y| {
            let Exposure { start, end } = exposures[l];
            let light = (start.0..end.0)
                .step_by(step_ns as usize)
                .map(|t| libm::exp(log_light(x, y, t)))
                .sum::<f64>();
            if (x, y) == (5, 20) { f32::NAN } else { (1000.0 * light * step_ns as f64 * 1e-9) as f32 }
        });
        let text = format!(
            "format = \"photocurrent-sensor/1\"\n[front_end]\ntau_0 = \"20 us\"\nalpha = \"1 ms\"\n\
             [comparator]\nthreshold_on = 0.2\nthreshold_off = 0.2\n[readout]\nrefractory = \"10 us\"\n\
             [frames]\ngain = 1000.0\n{sensor}"
        );
        (testing::stream(extent, events), frames, Sensor::parse(&Source::new("s.toml", "", text)).unwrap())
    }

    #[test]
    fn some_pixels_are_solved_as_the_whole_recording_is() {
        for (effects, rows) in
            [("", [1, 2, 20]), ("[effects]\ncrosstalk = { fraction = 0.2 }\n", [1, 19, 33])]
        {
            let (events, frames, sensor) = recorded(effects);
            let recording = Recording { events: &events, frames: &frames, sensor: &sensor };
            let options = SolveOptions::default();
            let whole = solve(&recording, &options).unwrap().tracks;
            let pixels: Vec<u32> = rows.iter().flat_map(|row| [3, 5, 23].map(|x| row * 24 + x)).collect();
            let some = solve_pixels(&recording, &options, &pixels, &()).unwrap();
            let band = whole.read(whole.rows()).unwrap();
            for (pixel, track) in pixels.iter().zip(&some) {
                let of_whole = band.pixel(pixel % 24, pixel / 24);
                assert_eq!(track.t_ns, of_whole.t, "pixel {pixel}");
                assert!(
                    track
                        .photocurrent
                        .iter()
                        .zip(of_whole.photocurrent)
                        .all(|(a, b)| a.to_bits() == f64::from(*b).to_bits())
                );
            }
            let without_frame = pixels.iter().position(|pixel| *pixel == 20 * 24 + 5);
            assert!(without_frame.is_none_or(|n| some[n].t_ns.is_empty()));
            assert!(some[0].has_converged && some[0].t_ns.len() > 5);
        }
    }
}

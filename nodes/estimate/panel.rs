//! Events and frames of the busiest pixels, the input of the estimates.
//!
//! The picture is cut into bands of rows, and the pixels with most events are selected in each, without the
//! very busiest, which may be hot. A long recording is sampled by runs of neighbouring frames spread over it.

use photocurrent_core::{
    DataType, EventStream, EventsMeta, FrameSequence, FramesMeta, NodeError, Rows, Sensor,
};
use photocurrent_formats::survey::pictures::chosen;
use photocurrent_sensor::estimate::{Centring, Delay, NOWHERE, Panel, Stretch};
use photocurrent_sensor::front_end::FrontEnd;

/// Numbers of frames and pixels that are evaluated.
#[derive(Clone, Copy, Debug)]
pub struct PanelSettings {
    /// Frames, at most.
    pub frames: usize,
    /// Pixels, at most.
    pub pixels: usize,
    /// Steps of time from frame to frame.
    pub steps: i64,
    /// Are rows that are exposed later compared at their own time?
    pub by_row: bool,
    /// Is the delay of a stated front end subtracted from the events' times?
    pub by_front_end: bool,
}

impl Default for PanelSettings {
    fn default() -> PanelSettings {
        PanelSettings { frames: 48, pixels: 4096, steps: 32, by_row: false, by_front_end: false }
    }
}

/// Bands of rows.
const BANDS: u32 = 16;
/// Largest distance of neighbouring frames, in usual periods: changes are measured between neighbours, and a
/// pause has none.
const GAP: i64 = 4;
/// Share of a band's busiest pixels, one in this many, that are excluded as possibly hot.
const HOT: usize = 200;
/// A step of an eight-bit scale, as a share of the largest value: darker values count as this.
const DARK: f32 = 0.5 / 255.0;

/// No event is put earlier for its front end by more than this part of a frame period: in darkness no time is
/// long enough.
const DELAY_SHARE: f64 = 0.5;

/// From this part of a frame's largest value on it may be saturated.
const SATURATED: f32 = 0.995;

/// Refuses frames that are no whole multiple of the events' pixels.
pub(crate) fn fits(events: &EventsMeta, frames: &FramesMeta) -> Result<u32, NodeError> {
    let (e, f) = (events.extent, frames.extent);
    let times = f.width / e.width.max(1);
    if times == 0 || (e.width * times, e.height * times) != (f.width, f.height) {
        return Err(NodeError::usage(format!(
            "frames of {f} pixels are no whole multiple of the events' {e}"
        ))
        .hint("crop or align the frames to the events' pixels first")
        .blames(DataType::Frames));
    }
    Ok(times)
}

/// Events and frames side by side.
///
/// # Errors
/// When a stream cannot be read, or frames are no whole multiple of the events' pixels.
pub fn panel(
    events: &EventStream,
    frames: &FrameSequence,
    sensor: Option<&Sensor>,
    settings: &PanelSettings,
) -> Result<Panel, NodeError> {
    let times = fits(&events.meta, &frames.meta)?;
    let extent = events.meta.extent;
    let width = extent.width as usize;
    let bands = extent.rows().bands(extent.height.div_ceil(BANDS).max(1));
    let place_of = busiest_pixels(events, &bands, settings)?;
    let mut panel = Panel::new(&place_of, extent.width, extent.height);
    let all: Vec<i64> = (0..frames.len()).map(|frame| frames.meta.times.exposure(frame, 0).mid().0).collect();
    let mut periods: Vec<i64> =
        all.windows(2).map(|pair| pair[1] - pair[0]).filter(|period| *period > 0).collect();
    periods.sort_unstable();
    let Some(period) = periods.get(periods.len() / 2).copied() else { return Ok(panel) };
    let runs = neighbour_runs(&chosen(frames.len(), settings.frames), &all, period);
    for run in &runs {
        let mids = run.iter().map(|frame| all[*frame]).collect();
        panel.stretches.push(Stretch::new(
            mids,
            period + period / 4,
            (period / settings.steps).max(1),
            panel.places(),
        ));
    }
    pictures(frames, &runs, &place_of, times, sensor, &mut panel)?;
    let row_time_ns =
        if settings.by_row { frames.meta.times.row_time_ns.saturating_mul(i64::from(times)) } else { 0 };
    for (stretch, run) in panel.stretches.iter_mut().zip(&runs) {
        for (within, &frame) in run.iter().enumerate() {
            let exposure = frames.meta.times.exposure(frame, 0);
            if let Some(delay) = delay(
                sensor.filter(|_| settings.by_front_end),
                (exposure.end.0 - exposure.start.0) as f64,
                DELAY_SHARE * period as f64,
            ) {
                stretch.delay(within, |log| delay.ns(libm::exp(f64::from(log))));
            }
        }
    }
    let mut centring = Centring::new(extent.pixels(), period / 4);
    let put = |panel: &mut Panel, pixel: usize, t: i64, is_on: bool| {
        let t = t.saturating_sub(row_time_ns.saturating_mul((pixel / width) as i64));
        // Runs may overlap by their margins: an event belongs to each.
        let after = panel.stretches.partition_point(|stretch| stretch.start_ns <= t);
        for n in after.saturating_sub(2)..after {
            let stretch = &mut panel.stretches[n];
            let late_ns = stretch.lag_ns(t, place_of[pixel] as usize);
            stretch.event(t.saturating_sub(late_ns as i64), place_of[pixel] as usize, is_on);
        }
    };
    for band in bands {
        let read = events.read(band)?;
        for y in band.iter() {
            let row = read.row(y);
            for k in 0..row.len() {
                let pixel = y as usize * width + usize::from(row.x[k]);
                if place_of[pixel] != NOWHERE
                    && let Some((t, is_on)) = centring.next(pixel, row.t[k], row.on[k] == 1)
                {
                    put(&mut panel, pixel, t, is_on);
                }
            }
        }
    }
    let rest: Vec<_> = centring.rest().collect();
    rest.into_iter().for_each(|(pixel, t, is_on)| put(&mut panel, pixel, t, is_on));
    Ok(panel)
}

/// Frames that are read, as runs of neighbours in order of time.
fn neighbour_runs(read: &[usize], all: &[i64], period: i64) -> Vec<Vec<usize>> {
    let mut runs: Vec<Vec<usize>> = Vec::new();
    for &frame in read {
        match runs.last_mut() {
            Some(run)
                if run.last().is_some_and(|last| {
                    last + 1 == frame && all[*last] < all[frame] && all[frame] - all[*last] < GAP * period
                }) =>
            {
                run.push(frame)
            }
            _ => runs.push(vec![frame]),
        }
    }
    runs
}

/// Delay by the stated front end, where it and the unit of its photocurrent are stated.
fn delay(sensor: Option<&Sensor>, exposure_ns: f64, most_ns: f64) -> Option<Delay> {
    let sensor = sensor?;
    let (alpha, gain) = sensor.front_end.alpha.zip(sensor.frames.gain)?;
    let tau_0_s = sensor.front_end.tau_0.map_or(0.0, |tau| tau.ns() as f64 * 1e-9);
    Delay::new(FrontEnd { tau_0_s, alpha_s: alpha.ns() as f64 * 1e-9 }, gain, exposure_ns, most_ns)
}

/// Numbers the pixels with most events of each band of rows.
fn busiest_pixels(
    events: &EventStream,
    bands: &[Rows],
    settings: &PanelSettings,
) -> Result<Vec<u32>, NodeError> {
    let extent = events.meta.extent;
    let mut place_of = vec![NOWHERE; extent.pixels()];
    let (a_band, mut next) = ((settings.pixels / bands.len().max(1)).max(1), 0);
    for band in bands {
        let read = events.read(*band)?;
        let mut counts = vec![0u32; band.len() * extent.width as usize];
        for y in band.iter() {
            let row = (y - band.start) as usize * extent.width as usize;
            read.row(y).x.iter().for_each(|x| counts[row + usize::from(*x)] += 1);
        }
        let mut order: Vec<usize> = (0..counts.len()).filter(|pixel| counts[*pixel] > 0).collect();
        order.sort_unstable_by_key(|pixel| (std::cmp::Reverse(counts[*pixel]), *pixel));
        let hot = order.len() / HOT;
        for pixel in order.into_iter().skip(hot).take(a_band) {
            place_of[band.start as usize * extent.width as usize + pixel] = next;
            next += 1;
        }
    }
    Ok(place_of)
}

/// Logarithms of the frames over black level; saturated values, and without a stated saturation a frame's
/// largest, are not known.
fn pictures(
    frames: &FrameSequence,
    runs: &[Vec<usize>],
    place_of: &[u32],
    times: u32,
    sensor: Option<&Sensor>,
    panel: &mut Panel,
) -> Result<(), NodeError> {
    let black = sensor.and_then(|sensor| sensor.frames.black_level_dn).unwrap_or(0.0) as f32;
    let stated = sensor.and_then(|sensor| sensor.frames.saturation_dn).map(|full| full as f32);
    let (channels, width) = (frames.meta.channels() as usize, frames.meta.extent.width / times);
    let mut dark = 0.0f32;
    for (stretch, run) in runs.iter().enumerate() {
        for (within, &frame) in run.iter().enumerate() {
            let block = frames.read(frame..frame + 1, frames.rows())?;
            // Where nothing states at which value the sensor ends, it may be at the largest.
            let largest = || block.dn.iter().copied().filter(|dn| dn.is_finite()).fold(0.0, f32::max);
            let full = stated.unwrap_or_else(|| SATURATED * largest());
            if dark == 0.0 {
                dark = DARK
                    * block
                        .dn
                        .iter()
                        .copied()
                        .filter(|dn| dn.is_finite())
                        .fold(0.0, |most, dn| f32::max(most, dn - black));
            }
            let (mut sums, mut counts) = (vec![0.0f32; panel.places()], vec![0u32; panel.places()]);
            for y in frames.rows().iter() {
                let row = block.row(frame, y);
                for x in 0..frames.meta.extent.width {
                    let place = place_of[((y / times) * width + x / times) as usize];
                    let values = &row[x as usize * channels..][..channels];
                    if place != NOWHERE && values.iter().all(|dn| dn.is_finite() && *dn < full) {
                        let light = values.iter().sum::<f32>() / channels as f32 - black;
                        sums[place as usize] += libm::logf(light.max(dark).max(1e-9));
                        counts[place as usize] += 1;
                    }
                }
            }
            // A place whose part is saturated would change by what is left out.
            let whole = times * times;
            let log = panel.stretches[stretch].frame_mut(within);
            log.iter_mut().zip(sums).zip(counts).for_each(|((log, sum), count)| {
                *log = if count == whole { sum / count as f32 } else { f32::NAN }
            });
        }
    }
    Ok(())
}

//! One pixel by itself: its events and frame values to its light, without a recording around.

use crate::options::{LEAST_FRAME_SIGMA_DN, NO_EVENT_SIGMA, STEPS, SolveOptions};
use crate::track::PixelTrack;
use photocurrent_core::events::Polarity;
use photocurrent_core::{Exposure, NodeError, Sensor};
use photocurrent_sensor::map::{
    MapFrame, MapGroup, MapOptions, MapProblem, MapStatus, Noise, PixelEvent, SecondStart, estimate,
};
use photocurrent_sensor::model::Model;

/// The MAP estimate of one pixel's light from its events (in-pixel time in ns, polarity; in order) and its
/// frame values (exposure, DN), with the noise of events and the prior that are usual.
///
/// # Errors
/// When the description lacks thresholds, gain, refractory period or, unless `front_end` is ideal, time
/// constants; or there is no frame.
pub fn solve_pixel(
    sensor: &Sensor,
    events: &[(i64, Polarity)],
    frames: &[(Exposure, f64)],
    options: &SolveOptions,
) -> Result<PixelTrack, NodeError> {
    options.check()?;
    let who = "solve_pixel";
    let refractory = sensor.need(sensor.readout.refractory, "readout.refractory", who)?;
    let comparator = &sensor.comparator;
    let fields = [
        ("comparator.threshold_on", comparator.threshold_on.is_some()),
        ("comparator.threshold_off", comparator.threshold_off.is_some()),
        ("frames.gain", sensor.frames.gain.is_some()),
    ];
    sensor.need_all(&fields, who)?;
    let mut model = Model::of(sensor);
    model.pixel.front_end = crate::model::front_end(options.front_end, sensor)?;
    model.pixel.refractory_ns = refractory.ns();
    let frame = |&(exposure, dn): &(Exposure, f64)| MapFrame {
        start_ns: exposure.start.0,
        end_ns: exposure.end.0,
        dn,
        sigma_dn: model.frame_sigma_of_dn(
            dn - model.number.black_level,
            [LEAST_FRAME_SIGMA_DN, 0.0],
            options.frame_noise,
        ),
        saturated: dn >= model.saturation_dn,
    };
    let frames: Vec<MapFrame> = frames.iter().filter(|(_, dn)| dn.is_finite()).map(frame).collect();
    let event = |&(t_ns, polarity): &(i64, Polarity)| PixelEvent {
        t_in_ns: t_ns,
        t_off_ns: t_ns,
        polarity: if polarity == Polarity::On { 1 } else { -1 },
    };
    let events: Vec<PixelEvent> = events.iter().map(event).collect();
    let instants = || {
        frames
            .iter()
            .flat_map(|frame| [frame.start_ns, frame.end_ns])
            .chain(events.iter().map(|event| event.t_in_ns))
    };
    let (Some(start_ns), Some(end_ns), false) = (instants().min(), instants().max(), frames.is_empty())
    else {
        return Err(NodeError::usage(
            "there is no frame value, and events alone leave the photocurrent's level open",
        )
        .hint("give at least one frame"));
    };
    let problem = MapProblem {
        noise: options.event_noise.map_or_else(Noise::default, |event| Noise { event, ..Noise::default() }),
        no_event_sigma: NO_EVENT_SIGMA,
        ..MapProblem::new(model.map_sensor(), &events, &frames, (start_ns, end_ns))
    };
    let map = MapOptions {
        spacing_ns: options.knot_spacing.ns(),
        max_iterations: options.max_iterations.min(STEPS) as usize,
        with_sigma: true,
        second: Some(SecondStart::USUAL),
        ..MapOptions::default()
    };
    let mut group = MapGroup::default();
    let solution = photocurrent_sensor::map::solve(&problem, &map, &mut group);
    Ok(PixelTrack {
        t_ns: solution.t_ns.to_vec(),
        photocurrent: solution.log_photocurrent.iter().map(|log| libm::exp(*log)).collect(),
        log_sigma: solution
            .variance
            .iter()
            .map(|variance| libm::exp(estimate::log_sigma(*variance)))
            .collect(),
        has_converged: solution.outcome.status != MapStatus::Failed,
    })
}

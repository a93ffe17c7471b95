//! `baseline/edi`: the event-based double integral, exactly.
//!
//! Idea: between events a pixel's log light is constant, at an event it moves by one threshold. So the latent
//! picture is known up to one factor per pixel, `L(t) = L(f) exp(E(t))`, and the blurred frame, which is the
//! mean of L over its exposure, fixes the factor: `L(f) = B / mean(exp(E))`. Both integrals are piecewise
//! constant and taken exactly, per pixel and with the row's own exposure. A frame elsewhere in time starts
//! from the captured frame nearest to it. With `chain`, frames are not each for itself: least squares over
//! the logs of all frames' latent values, where events say how consecutive ones differ (mEDI).
//!
//! What its authors leave implicit stands in the open: the exposure is the recording's, the threshold is the
//! sensor description's, a given number or one found by `baseline/contrast`, and a constant latency can be
//! subtracted from the stamps. With colour, a mosaic or more pixels than the events, every value of a frame
//! is taken with the events of the event pixel that it lies on. Limits: no front-end delay, no readout
//! latency, no refractory period.

mod on_card;

use crate::backend::{Backend, Machine};
use crate::held::{Exposures, HeldMeans, Knots, Lanes, TILE, develop};
pub use crate::reconstruct::In;
use crate::reconstruct::{Request, black_level, contrast_of, events_of, in_rows, nearest_frame};
use crate::sampling::{Sampling, scale_seconds};
use multiversion::multiversion;
use photocurrent_core::events::{EventRow, PixelIndex};
use photocurrent_core::node::Working;
use photocurrent_core::quantity::Duration;
use photocurrent_core::{
    Context, Decl, Exposure, FrameBlock, FrameSequence, FramesMeta, Grain, Meta, Node, NodeError, PortMetas,
};
use photocurrent_sensor::elementary;
use photocurrent_solve::pixel_events::{Stamp, StepRule};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::sync::Arc;

/// Parameters of `baseline/edi`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(deny_unknown_fields)]
pub struct Params {
    /// Steady sampling, when nothing is connected to `at`.
    #[serde(flatten)]
    pub sampling: Sampling,
    /// One threshold for both polarities, natural-log units; absent = the one at `contrast`, else the sensor
    /// description's two.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub threshold: Option<f64>,
    /// Which stamp dates an event.
    pub stamp: Stamp,
    /// A constant latency to subtract from every stamp; negative moves events later.
    pub latency: Duration,
    /// Weight of the equations that chain consecutive frames by the events between them, against those of
    /// each frame's blur: 0 leaves each frame to itself (EDI), 1 weighs both alike (mEDI).
    #[schemars(range(min = 0.0))]
    pub chain: f64,
    /// Length over which a captured frame's blur is taken, around the middle of its exposure; absent = its
    /// exposure as recorded.
    #[schemars(extend("x-min" = "1 ns"))]
    pub blur: Option<Duration>,
    /// What takes the means: `cpu`, this processor, or `gpu`, a graphics card, for programs built with the
    /// feature `gpu`; without either it is an error. Pictures are the same to 1e-5 of their light. Where each
    /// frame has a threshold of its own, it is done on the processor then too.
    pub backend: Backend,
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// The reconstructed frames, linear DN.
        frames: FrameSequence,
    }
}

/// The node.
pub struct BaselineEdi {
    params: Params,
    machine: Machine,
}

impl BaselineEdi {
    fn rule(&self, request: &Request, searched: Option<f64>) -> Result<StepRule, NodeError> {
        request.step_rule(
            "baseline/edi",
            self.params.threshold,
            searched,
            self.params.stamp,
            self.params.latency,
        )
    }

    /// Thresholds of the captured frames over the first one's; empty when there is one for all.
    fn per_frame(&self, searched: Option<&[f64]>, frames: &FramesMeta) -> Result<Vec<f64>, NodeError> {
        match searched {
            Some(values) if values.len() > 1 && self.params.threshold.is_none() => {
                if values.len() != frames.times.len() {
                    return Err(NodeError::input(format!(
                        "there are {} thresholds at `contrast`, and {} frames",
                        values.len(),
                        frames.times.len()
                    ))
                    .hint("search them on the same frames"));
                }
                if self.params.chain > 0.0 {
                    return Err(NodeError::usage(
                        "`chain` takes one threshold for all frames, and `contrast` has one for each",
                    )
                    .hint("search with `per = \"sequence\"`, or leave `chain` at 0")
                    .param("chain"));
                }
                Ok(values.iter().map(|value| value / values[0]).collect())
            }
            _ => Ok(Vec::new()),
        }
    }
}

impl Node for BaselineEdi {
    const DECL: Decl = Decl {
        kind: "baseline/edi",
        about: "The event-based double integral, exactly, with threshold, exposure and latency in the open.",
        revision: 2,
        grain: Grain::Pixel,
        draws: false,
        exports: false,
        sources: &[
            "Pan et al., Bringing a Blurry Frame Alive at High Frame-Rate with an Event Camera, CVPR 2019; \
             High Frame Rate Video Reconstruction (mEDI), TPAMI 2020",
        ],
        example: r#"
[nodes.edi]
kind   = "baseline/edi"
in     = { events = "recording.events", frames = "recording.frames", sensor = "sensor" }
params = { rate = "1 kHz", latency = "40 us" }
"#,
    };
    const LOCAL_IN_TIME: bool = true;
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        let machine = Machine::new(params.backend)?;
        Ok(BaselineEdi { params, machine })
    }

    fn machine(&self) -> Option<String> {
        self.machine.name().map(String::from)
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let request = Request::planned(inputs)?;
        self.rule(&request, inputs.has("contrast").then_some(1.0))?;
        Ok(vec![Meta::Frames(Arc::new(request.output(&self.params.sampling)?))])
    }

    fn working(&self, _inputs: &PortMetas) -> Working {
        self.machine.working(None)
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let request = input.request();
        let searched = input.contrast.as_deref().map(contrast_of).transpose()?;
        let rule = self.rule(&request, searched.map(|values| values[0]))?;
        let per_frame = self.per_frame(searched, request.frames)?;
        let meta = request.output(&self.params.sampling)?;
        let job = Job {
            captured: request.frames,
            output: &meta,
            rule,
            per_frame,
            black: black_level(request.sensor),
            params: &self.params,
        };
        let events = events_of(&input.events, request.frames, cx.rows())?;
        let frames = input.frames.read_rows(cx.rows())?;
        if let (Some(card), Some(name)) = (self.machine.open()?, self.machine.name()) {
            cx.note(format!("rendered on {name}"));
            if job.per_frame.is_empty() {
                return Ok(Out { frames: on_card::frames(&job, card.integrator, &events, &frames, cx)? });
            }
            cx.count(
                cx.rows().len() as u64,
                "rows were done on the processor: each frame has its own threshold",
            );
        }
        Ok(Out {
            frames: in_rows(cx, meta.clone(), |row, out| {
                events.with_row(row, |events| job.row(row, &events, &frames, out))
            })?,
        })
    }
}

struct Job<'a> {
    captured: &'a FramesMeta,
    output: &'a FramesMeta,
    rule: StepRule,
    /// Each captured frame's threshold over that of `rule`; empty when there is one for all.
    per_frame: Vec<f64>,
    black: f64,
    params: &'a Params,
}

impl Job<'_> {
    /// The interval over which a captured frame is taken to be the mean of the light.
    fn blurred_over(&self, exposure: Exposure) -> Exposure {
        self.params.blur.map_or(exposure, |blur| {
            let start = exposure.mid().0 - blur.ns() / 2;
            Exposure::new(start, start + blur.ns())
        })
    }

    /// One row of all output frames.
    fn row(&self, row: u32, events: &EventRow, frames: &FrameBlock, out: &mut [&mut [f32]]) {
        let seconds: Vec<f64> = (0..out.len())
            .map(|l| scale_seconds(self.output.scale, self.output.times.exposure(l, row)))
            .collect();
        self.latent(row, events, frames, |latent| {
            develop(
                latent.mean,
                &seconds[latent.frames.clone()],
                self.black,
                latent.level,
                &mut out[latent.frames],
                latent.left,
            );
        });
    }

    /// Shows the latent light of one row, piece by piece: tiles of pixels, and output frames that start from
    /// the same captured one.
    fn latent(&self, row: u32, events: &EventRow, frames: &FrameBlock, mut show: impl FnMut(Latent)) {
        let width = self.captured.row_values();
        let index = events.by_pixel(width as u32);
        let captured: Vec<Exposure> =
            (0..self.captured.times.len()).map(|l| self.captured.times.exposure(l, row)).collect();
        let outputs = Exposures::new(
            (0..self.output.times.len()).map(|l| self.output.times.exposure(l, row)).collect(),
        );
        let groups = groups_of(outputs.all().iter().map(|e| nearest_frame(self.captured, row, e.mid().0)));
        let mut light = RelativeLight::default();
        let (mut levels, mut means) = (Levels::default(), HeldMeans::default());
        // With one threshold, one pass makes all frames; else each captured frame and those that start from
        // it have a pass.
        let passes: Vec<_> =
            if self.per_frame.is_empty() { vec![&groups[..]] } else { groups.chunks(1).collect() };
        for groups in passes {
            let (Some(first), Some(last)) = (groups.first(), groups.last()) else { return };
            let used = if self.per_frame.is_empty() { 0..captured.len() } else { first.0..first.0 + 1 };
            light.fill(
                &self.rule,
                events,
                &index,
                width,
                self.per_frame.get(used.start).copied().unwrap_or(1.0),
            );
            let blurred: Vec<Exposure> =
                captured[used.clone()].iter().map(|exposure| self.blurred_over(*exposure)).collect();
            // A stated blur lies around the middles, and those of exposures of different lengths need not be
            // in order.
            let blurred: Vec<Exposures> =
                blurred.chunk_by(|a, b| a.start <= b.start).map(|run| Exposures::new(run.to_vec())).collect();
            for left in (0..width).step_by(TILE) {
                let tile = left..width.min(left + TILE);
                levels.of_frames.clear();
                for run in &blurred {
                    let mean = means.of(run, 0..run.len(), light.of(tile.clone()));
                    let dn = |l: usize| &frames.row(l, row)[tile.clone()];
                    levels.measure(used.start + levels.of_frames.len(), &captured, dn, self.black, mean);
                }
                if self.params.chain > 0.0 {
                    levels.chain(self.params.chain);
                }
                for piece in Exposures::pieces(first.1.start..last.1.end) {
                    let mean = means.of(&outputs, piece.clone(), light.of(tile.clone()));
                    let first = groups.partition_point(|(_, group)| group.end <= piece.start);
                    for (frame, group) in
                        groups[first..].iter().take_while(|(_, group)| group.start < piece.end)
                    {
                        let frames = group.start.max(piece.start)..group.end.min(piece.end);
                        let mean = &mean[frames.start - piece.start..frames.end - piece.start];
                        show(Latent { left, frames, mean, level: &levels.of_frames[frame - used.start] });
                    }
                }
            }
        }
    }
}

/// The latent light of up to sixteen pixels in some output frames: `level` times `mean`, above black and per
/// second.
struct Latent<'a> {
    /// The first pixel's place in its row.
    left: usize,
    /// Which output frames; all start from the same captured one.
    frames: Range<usize>,
    /// Mean relative light of each frame and pixel.
    mean: &'a [Lanes],
    /// What one of relative light is, each pixel.
    level: &'a Lanes,
}

/// Runs of output frames that start from the same captured one: that one, and the run.
fn groups_of(starts_from: impl Iterator<Item = usize>) -> Vec<(usize, Range<usize>)> {
    let mut groups: Vec<(usize, Range<usize>)> = Vec::new();
    for (l, frame) in starts_from.enumerate() {
        match groups.last_mut() {
            Some((of, run)) if *of == frame => run.end = l + 1,
            _ => groups.push((frame, l..l + 1)),
        }
    }
    groups
}

/// What one of relative light is in each captured frame, for a tile of pixels.
#[derive(Default)]
struct Levels {
    of_frames: Vec<Lanes>,
    of_pixel: Vec<f64>,
    work: Vec<f64>,
}

impl Levels {
    /// Adds captured frames over mean relative light: `blurred` has the means over the blur of the frames
    /// from `first` on, `dn` a frame's values.
    fn measure<'a>(
        &mut self,
        first: usize,
        captured: &[Exposure],
        dn: impl Fn(usize) -> &'a [f32],
        black: f64,
        blurred: &[Lanes],
    ) {
        for (l, mean) in (first..).zip(blurred) {
            // The mean over the blur, as charge of the exposure: with the recorded exposure, the plain
            // integral.
            let seconds = captured[l].seconds();
            let mut level = [f64::NAN; TILE];
            level
                .iter_mut()
                .zip(mean)
                .zip(dn(l))
                .for_each(|((level, mean), dn)| *level = (f64::from(*dn) - black) / (mean * seconds));
            self.of_frames.push(level);
        }
    }

    /// Chains the frames of each pixel.
    fn chain(&mut self, weight: f64) {
        for lane in 0..TILE {
            self.of_pixel.clear();
            self.of_pixel.extend(self.of_frames.iter().map(|level| level[lane]));
            chained(&mut self.of_pixel, weight, &mut self.work);
            self.of_frames.iter_mut().zip(&self.of_pixel).for_each(|(levels, level)| levels[lane] = *level);
        }
    }
}

/// Replaces every frame's level by that of least squares over their logs: each near its own, and, `weight`
/// times as important, consecutive ones alike.
///
/// A level is a frame's latent light with the events' share taken out, so that frames and events that agree
/// give equal ones. A level that is not positive has no log and counts as not measured; when none is left,
/// nothing changes. `work` is scratch.
fn chained(level: &mut [f64], weight: f64, work: &mut Vec<f64>) {
    let measured = |level: f64| if level > 0.0 && level.is_finite() { 1.0 } else { 0.0 };
    if level.iter().all(|level| measured(*level) == 0.0) {
        return;
    }
    // The normal equations are tridiagonal: one pass down, one up.
    let n = level.len();
    work.clear();
    for i in 0..n {
        let own = measured(level[i]);
        let links = f64::from(u8::from(i > 0)) + f64::from(u8::from(i + 1 < n));
        let (mut diagonal, mut right) =
            (own + weight * links, if own > 0.0 { libm::log(level[i]) } else { 0.0 });
        if i > 0 {
            let factor = weight * work[i - 1];
            diagonal -= factor * weight;
            right += factor * level[i - 1];
        }
        work.push(1.0 / diagonal);
        level[i] = right;
    }
    for i in (0..n).rev() {
        let below = if i + 1 < n { weight * level[i + 1] } else { 0.0 };
        level[i] = (level[i] + below) * work[i];
    }
    level.iter_mut().for_each(|level| *level = libm::exp(*level));
}

/// The light of a row's pixels, each up to a factor: exp of the summed steps, held between events.
#[derive(Default)]
struct RelativeLight {
    /// Where each pixel's knots begin, and their number.
    offsets: Vec<usize>,
    t: Vec<i64>,
    light: Vec<f64>,
}

/// Summed steps are kept inside this, so that their exponentials stay finite: e^600 is far beyond any sensor.
const LOG_LIGHT_LIMIT: f64 = 600.0;

impl RelativeLight {
    /// With every plain step times `factor`; compensated ones stay what they are.
    fn fill(&mut self, rule: &StepRule, events: &EventRow, index: &PixelIndex, width: usize, factor: f64) {
        let factor = if events.step.is_some() { 1.0 } else { factor };
        self.offsets.clear();
        self.t.clear();
        self.light.clear();
        self.t.reserve(width + events.len());
        self.light.reserve(width + events.len());
        for x in 0..width {
            self.offsets.push(self.t.len());
            // Before the first event the light is 1, whenever that event came.
            let (mut last, mut log_light) = (i64::MIN / 4, 0.0);
            self.t.push(last);
            self.light.push(log_light);
            for &k in index.pixel(x) {
                log_light =
                    f64::clamp(log_light + factor * rule.step(events, k), -LOG_LIGHT_LIMIT, LOG_LIGHT_LIMIT);
                // Stamps of one pixel may fall back by their jitter; a step never comes before the one before
                // it.
                last = rule.time(events, k).max(last);
                self.t.push(last);
                self.light.push(log_light);
            }
        }
        self.offsets.push(self.t.len());
        exponentials(&mut self.light);
    }

    /// Some pixels' knots.
    fn of(&self, pixels: Range<usize>) -> impl Iterator<Item = Knots<'_, f64>> {
        self.offsets[pixels.start..=pixels.end]
            .windows(2)
            .map(|of| Knots { t: &self.t[of[0]..of[1]], value: &self.light[of[0]..of[1]] })
    }
}

/// Every logarithm becomes what it is the logarithm of.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw+avx512cd", "x86_64+avx2", "aarch64+neon"))]
fn exponentials(logs: &mut [f64]) {
    for log in logs {
        *log = elementary::exp(*log);
    }
}

#[cfg(test)]
mod tests {
    use super::super::reference;
    use super::*;
    use photocurrent_core::events::{Event, Polarity};
    use photocurrent_core::quantity::Rate;
    use photocurrent_core::{Extent, Sensor, Table, testing};

    const ONE: Extent = Extent { width: 1, height: 1 };

    fn on(t: i64) -> Event {
        Event { x: 0, y: 0, polarity: Polarity::On, t, t_in: None }
    }

    fn edi(params: Params, events: Vec<Event>, exposures: Vec<Exposure>, dn: f32) -> Vec<f32> {
        let frames = testing::captured(ONE, exposures, 0, |_, _, _| dn);
        let input =
            In { events: testing::stream(ONE, events), frames, sensor: None, contrast: None, at: None };
        let (out, _) = testing::with_context(ONE.rows(), &["frames"], |cx| {
            BaselineEdi::build(params).unwrap().run(input, cx)
        });
        out.unwrap().frames.read_rows(ONE.rows()).unwrap().dn
    }

    fn params(hz: f64) -> Params {
        Params {
            threshold: Some(libm::log(2.0)),
            sampling: Sampling { rate: Rate::new(hz), exposure: Duration::new(1000), ..Sampling::default() },
            ..Params::default()
        }
    }

    #[test]
    fn one_doubling_in_the_middle_splits_the_blur_one_to_two() {
        // Mean of L and 2L is 30: L = 20 before, 40 after.
        let dn = edi(params(1000.0), vec![on(2_500_000)], vec![Exposure::new(0, 5_000_000)], 30.0);
        assert_eq!(dn.len(), 5);
        for (found, expected) in dn.iter().zip([20.0, 20.0, 20.0, 40.0, 40.0]) {
            assert!((found - expected).abs() < 1e-4, "{dn:?}");
        }
    }

    #[test]
    fn without_events_the_frame_is_repeated() {
        let mut given = edi(params(1000.0), vec![], vec![Exposure::new(0, 5_000_000)], 30.0);
        given.dedup();
        assert_eq!(given, [30.0]);
    }

    #[test]
    fn a_latency_moves_the_edge() {
        let late = Params { latency: Duration::new(1_000_000), ..params(1000.0) };
        let dn = edi(late, vec![on(3_500_000)], vec![Exposure::new(0, 5_000_000)], 30.0);
        assert!((dn[2] - 20.0).abs() < 1e-4 && (dn[3] - 40.0).abs() < 1e-4);
    }

    #[test]
    fn chained_levels_solve_their_normal_equations() {
        let measured = [2.0, 8.0, -1.0, 4.0];
        let (weight, mut level) = (0.7, measured.to_vec());
        chained(&mut level, weight, &mut Vec::new());
        let k: Vec<f64> = level.iter().map(|level| libm::log(*level)).collect();
        for i in 0..4 {
            let own = if measured[i] > 0.0 { k[i] - libm::log(measured[i]) } else { 0.0 };
            let below = if i > 0 { k[i] - k[i - 1] } else { 0.0 };
            let above = if i < 3 { k[i] - k[i + 1] } else { 0.0 };
            assert!((own + weight * (below + above)).abs() < 1e-12, "row {i}");
        }
        // Nothing measured: nothing to chain.
        let mut dark = [0.0, -1.0];
        chained(&mut dark, 1.0, &mut Vec::new());
        assert_eq!(dark, [0.0, -1.0]);
    }

    #[test]
    fn frames_that_disagree_meet_in_their_logs_when_chained() {
        // No events: 20 and 80 in a still pixel. With weight w, logs are drawn together to a distance of 1 /
        // (1 + 2 w) of theirs.
        let exposures = vec![Exposure::new(0, 2_000_000), Exposure::new(8_000_000, 10_000_000)];
        let frames = testing::captured(ONE, exposures, 0, |l, _, _| [20.0, 80.0][l]);
        let input =
            In { events: testing::stream(ONE, vec![]), frames, sensor: None, contrast: None, at: None };
        let params = Params { chain: 1.0, ..params(200.0) };
        let (out, _) = testing::with_context(ONE.rows(), &["frames"], |cx| {
            BaselineEdi::build(params).unwrap().run(input, cx)
        });
        let dn = out.unwrap().frames.read_rows(ONE.rows()).unwrap().dn;
        let apart = libm::exp(libm::log(4.0) / 6.0);
        assert!(
            (f64::from(dn[0]) - 40.0 / apart).abs() < 1e-4 && (f64::from(dn[1]) - 40.0 / apart).abs() < 1e-4,
            "{dn:?}"
        );
    }

    #[test]
    fn each_frame_may_have_its_own_threshold() {
        // One ON event in the middle of each exposure; thresholds log 2 and log 3: the mean 30 is split 20 to
        // 40, then 15 to 45.
        let exposures = vec![Exposure::new(0, 4_000_000), Exposure::new(10_000_000, 14_000_000)];
        let frames = testing::captured(ONE, exposures, 0, |_, _, _| 30.0);
        let thresholds = photocurrent_core::table::Column::Numbers(vec![libm::log(2.0), libm::log(3.0)]);
        let contrast = Some(Arc::new(Table::default().with("contrast", thresholds)));
        let events = testing::stream(ONE, vec![on(2_000_000), on(12_000_000)]);
        let params = Params { threshold: None, ..params(1000.0) };
        let input = In { events, frames, sensor: None, contrast, at: None };
        let (out, _) = testing::with_context(ONE.rows(), &["frames"], |cx| {
            BaselineEdi::build(params).unwrap().run(input, cx)
        });
        let dn = out.unwrap().frames.read_rows(ONE.rows()).unwrap().dn;
        let at = |ms: usize| f64::from(dn[ms]);
        for (ms, expected) in [(1, 20.0), (3, 40.0), (11, 15.0), (13, 45.0)] {
            assert!((at(ms) - expected).abs() < 1e-4, "{ms} ms: {dn:?}");
        }
    }

    #[test]
    fn a_longer_blur_takes_in_events_outside_the_exposure() {
        // Exposed from 2 to 4 ms without an event, but blurred over 0 to 6 ms with a doubling at 5 ms: the
        // mean is (5 + 2) / 6 of L.
        let blurred = Params { blur: Some(Duration::new(6_000_000)), ..params(1000.0) };
        let dn = edi(blurred, vec![on(5_000_000)], vec![Exposure::new(2_000_000, 4_000_000)], 70.0);
        assert!((dn[0] - 60.0).abs() < 1e-3, "{dn:?}");
    }

    #[test]
    fn a_stated_blur_may_come_earlier_in_a_later_frame() {
        // Exposed from 0 to 10 and from 1 to 2 ms, blurred over 1 ms around 5 and around 1.5; a doubling at 5
        // ms. So 30 is 1.5 L in the first frame and L in the second.
        let blurred = Params { blur: Some(Duration::new(1_000_000)), ..params(1000.0) };
        let dn = edi(
            blurred,
            vec![on(5_000_000)],
            vec![Exposure::new(0, 10_000_000), Exposure::new(1_000_000, 2_000_000)],
            30.0,
        );
        // Instants before both middles start from the first frame, instants after both from the second. DN
        // are those of 1 ms, a tenth of the first exposure.
        assert!((dn[0] - 2.0).abs() < 1e-3 && (dn[9] - 60.0).abs() < 1e-3, "{dn:?}");
    }

    /// The reference works on 1 + I and takes the latent picture at the instant of the middle; the node gives
    /// means over exposures of 2 ns here, and stamps are whole microseconds, so that an event at the middle
    /// counts as after it when the exposure ends there.
    #[test]
    fn an_independent_double_integral_gives_the_same() {
        let expected = reference::pictures("edi_latent.f64");
        let captured = reference::frames();
        let kept: Vec<usize> = if expected.len() == 8 { (0..8).collect() } else { vec![0, 3, 7] };
        let mut sensor = Sensor::unknown("offset");
        // DN + 255 over 255 is 1 + I.
        sensor.frames.black_level_dn = Some(-255.0);
        let sensor = Arc::new(sensor);
        let at = testing::captured(
            reference::EXTENT,
            captured.meta.times.exposures.iter().map(|e| Exposure::new(e.mid().0 - 2, e.mid().0)).collect(),
            0,
            |_, _, _| 0.0,
        );
        let scaled = FramesMeta {
            scale: photocurrent_core::FrameScale::Nominal { exposure_ns: 20_000_000 },
            ..(*at.meta).clone()
        };
        let request =
            Request { frames: &captured.meta, events: None, at: Some(&scaled), sensor: Some(&sensor) };
        let rule = StepRule {
            threshold_on: reference::CONTRAST,
            threshold_off: reference::CONTRAST,
            stamp: Stamp::Best,
            shift_ns: 0,
        };
        let output = request.output(&Sampling::default()).unwrap();
        let job = Job {
            captured: &captured.meta,
            output: &output,
            rule,
            per_frame: Vec::new(),
            black: -255.0,
            params: &Params::default(),
        };
        let events = reference::stream().read(reference::EXTENT.rows()).unwrap();
        let block = captured.read_rows(captured.rows()).unwrap();
        for row in reference::EXTENT.rows().iter() {
            let mut picture = vec![0.0; output.times.len() * 48];
            // Twenty milliseconds are the scale, so light above black is times 0.02 s.
            job.latent(row, &events.row(row), &block, |latent| {
                for (l, mean) in latent.frames.zip(latent.mean) {
                    let columns = latent.left..48.min(latent.left + TILE);
                    for (n, x) in columns.enumerate() {
                        picture[l * 48 + x] = -255.0 + latent.level[n] * mean[n] * 0.02;
                    }
                }
            });
            for (authors, l) in expected.iter().zip(&kept) {
                let latent: Vec<f64> = picture[l * 48..][..48].iter().map(|dn| dn / 255.0).collect();
                let apart = reference::apart(&latent, &authors[row as usize * 48..][..48]);
                assert!(apart < 1e-9, "frame {l}, row {row}: {apart:e}");
            }
        }
    }

    #[test]
    fn a_threshold_must_come_from_somewhere() {
        let node = BaselineEdi::build(Params::default()).unwrap();
        let events = testing::stream(ONE, vec![]);
        let frames = testing::frames(1, 1, 1);
        let request = Request { frames: &frames.meta, events: Some(&events.meta), at: None, sensor: None };
        assert_eq!(node.rule(&request, None).unwrap_err().param.as_deref(), Some("threshold"));
        assert_eq!(node.rule(&request, Some(0.3)).unwrap().threshold_off, 0.3);
    }
}

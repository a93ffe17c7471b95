//! `baseline/contrast`: a contrast threshold, for a whole recording or for each frame, searched so that the
//! double integral looks right.
//!
//! Idea: with too small a threshold the latent picture stays blurred and its edges miss the events' edges;
//! with too large a one it gets a wild relief. So the energy is
//! `lambda x sum |Sobel L| - sum edge(L) x edge(M)`: relief of the latent picture, less the agreement of its
//! edges with those of the event picture M (events weighted by exp(-|t - f| / decay) around the middle f of
//! an exposure). Fibonacci search over the stated interval, energies summed over several frames of the
//! recording (`per = "sequence"`) or frame by frame (`per = "frame"`).
//!
//! AKF and CF work on log(1 + I), where the same events make smaller steps: with `white` the double integral
//! is taken of 1 + I, and the threshold is one for them.
//!
//! Source: the energy of Pan et al. as the public port davis-EDI-rs states it (lambda 0.15, interval 0.1 to
//! 0.5, 15 points, edges by 3x3 Sobel, scaled to [0, 1] and cut at mean + (1 - mean) / 3); the authors' own
//! interval is not public. Limits: one threshold for both polarities and all pixels; the energy is not
//! convex, and the search finds one of its valleys.

use crate::reconstruct::black_level;
use crate::spans::check_one_clock;
use photocurrent_core::events::{EventBand, Polarity};
use photocurrent_core::quantity::Duration;
use photocurrent_core::table::{Column, TableMeta};
use photocurrent_core::{
    Context, Decl, EventStream, Exposure, FrameSequence, Grain, Meta, Node, NodeError, PortMetas, Sensor,
    Table,
};
use photocurrent_sensor::exposure::HeldTrack;
use photocurrent_solve::co_located::CoLocated;
use photocurrent_solve::pixel_events::clock_offset;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What one threshold is searched for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Per {
    /// The recording: energies of several frames are summed.
    #[default]
    Sequence,
    /// Each captured frame.
    Frame,
}

/// Parameters of `baseline/contrast`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// What one threshold is searched for.
    pub per: Per,
    /// Lower end of the interval, natural-log units.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub lowest: f64,
    /// Upper end of the interval, natural-log units.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub highest: f64,
    /// The smallest Fibonacci number of at least this many points is used.
    #[schemars(range(min = 3, max = 1000))]
    pub points: u32,
    /// Weight of the relief term.
    #[schemars(range(min = 0.0))]
    pub lambda: f64,
    /// Decay of an event's weight away from the middle of the exposure.
    #[schemars(extend("x-min" = "1 us"))]
    pub decay: Duration,
    /// DN of white, I = 1, when the threshold is to be a step of log(1 + I), as `baseline/akf` and
    /// `baseline/cf` take it; absent = a step of log I, as `baseline/edi` takes it.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub white: Option<f64>,
    /// Most frames to look at, spread over the recording, when one threshold is searched for it.
    #[schemars(range(min = 1))]
    pub frames: u32,
}

impl Default for Params {
    fn default() -> Self {
        Params {
            per: Per::Sequence,
            lowest: 0.1,
            highest: 0.5,
            points: 15,
            lambda: 0.15,
            decay: Duration::new(20_000_000),
            white: None,
            frames: 8,
        }
    }
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Events.
        events: EventStream,
        /// Captured frames.
        frames: FrameSequence,
        /// Black level and clock offset.
        sensor: Option<Arc<Sensor>>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// `contrast`, and the `energy` there: one row, or one for each captured frame.
        contrast: Arc<Table>,
    }
}

/// The node.
pub struct BaselineContrast {
    params: Params,
}

impl BaselineContrast {
    /// DN above black that stand for the 1 of log(1 + I); 0 for log I.
    fn offset_dn(&self, sensor: Option<&Sensor>) -> Result<f64, NodeError> {
        let black = black_level(sensor);
        match self.params.white {
            Some(white) if white <= black => {
                Err(NodeError::usage(format!("white, {white} DN, is not above black, {black} DN"))
                    .hint("state a larger `white`")
                    .param("white"))
            }
            white => Ok(white.map_or(0.0, |white| white - black)),
        }
    }
}

impl Node for BaselineContrast {
    const DECL: Decl = Decl {
        kind: "baseline/contrast",
        about: "Searches the contrast threshold for the double integral, by the sharpness of the latent \
                pictures.",
        revision: 1,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["Pan et al., CVPR 2019, section 4; davis-EDI-rs"],
        example: r#"
[nodes.contrast]
kind   = "baseline/contrast"
in     = { events = "recording.events", frames = "recording.frames" }
params = { lowest = 0.1, highest = 0.5 }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        if params.lowest >= params.highest {
            return Err(NodeError::usage(format!(
                "the interval from {} to {} is empty",
                params.lowest, params.highest
            ))
            .param("lowest"));
        }
        Ok(BaselineContrast { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let (events, frames) = (inputs.events("events")?, inputs.frames("frames")?);
        CoLocated::new(events, frames)?.need_plain("baseline/contrast")?;
        let sensor = inputs.has("sensor").then(|| inputs.sensor("sensor")).transpose()?;
        self.offset_dn(sensor.map(|sensor| &**sensor))?;
        check_one_clock(events, frames, sensor.map(|sensor| &**sensor))?;
        if frames.times.is_empty() {
            return Err(NodeError::usage("there is no frame to search a threshold on")
                .hint("give at least one frame"));
        }
        Ok(vec![Meta::Table(Arc::new(TableMeta { scores: false }))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let sensor = input.sensor.as_deref();
        let shift_ns = sensor.map(clock_offset).transpose()?.map_or(0, |offset| offset.offset_ns);
        let events = input.events.read(input.events.rows())?;
        let frames = &input.frames;
        let about = About {
            shift_ns,
            black: black_level(sensor),
            offset_dn: self.offset_dn(sensor)?,
            decay_s: self.params.decay.seconds(),
        };
        let scene = |l: usize| Scene::new(frames, &events, l, about);
        let steps = fibonacci_steps(self.params.points);
        let search = |scenes: &[Scene]| {
            let energy = |contrast: f64| -> Result<f64, NodeError> {
                cx.advance(1)?;
                Ok(scenes
                    .par_iter()
                    .map(|scene| scene.energy(contrast, self.params.lambda))
                    .collect::<Vec<f64>>()
                    .iter()
                    .sum())
            };
            fibonacci_search(self.params.lowest, self.params.highest, steps, energy)
        };
        // Two evaluations at first, then one each step; one step is spent by the first two.
        let evaluations = u64::from(steps) + 1;
        let (chosen, found): (Vec<usize>, Vec<(f64, f64)>) = match self.params.per {
            Per::Sequence => {
                let count = frames.len().min(self.params.frames as usize);
                // Spread over the recording, ends left out where there is a choice.
                let chosen: Vec<usize> =
                    (0..count).map(|i| (2 * i + 1) * frames.len() / (2 * count)).collect();
                let scenes: Result<Vec<Scene>, NodeError> = chosen.iter().map(|&l| scene(l)).collect();
                cx.begin(evaluations, "thresholds");
                (chosen, vec![search(&scenes?)?])
            }
            Per::Frame => {
                cx.begin(evaluations * frames.len() as u64, "thresholds");
                let found: Result<Vec<(f64, f64)>, NodeError> =
                    (0..frames.len()).into_par_iter().map(|l| search(&[scene(l)?])).collect();
                ((0..frames.len()).collect(), found?)
            }
        };
        // The outermost places that the search looks at are one of its spacings inside the interval.
        let edge = 1.01 * (self.params.highest - self.params.lowest) / fibonacci(steps + 2);
        let at_end =
            |contrast: f64| contrast - self.params.lowest < edge || self.params.highest - contrast < edge;
        match (self.params.per, found[0].0) {
            (Per::Sequence, contrast) if at_end(contrast) => {
                cx.note(format!(
                    "the threshold found, {contrast:.3}, lies at the end of the interval {} to {}: widen it",
                    self.params.lowest, self.params.highest
                ));
            }
            (Per::Frame, _) => {
                let count = found.iter().filter(|(contrast, _)| at_end(*contrast)).count();
                cx.count(count as u64, "frames have their threshold at the end of the interval: widen it");
            }
            _ => {}
        }
        let column = |of: fn(&(f64, f64)) -> f64| Column::Numbers(found.iter().map(of).collect());
        let table = Table::default()
            .with("contrast", column(|found| found.0))
            .with("energy", column(|found| found.1));
        Ok(Out { contrast: Arc::new(table.note("frames", format!("{chosen:?}"))) })
    }
}

/// Number of evaluations that a search over at least `points` takes: n - 2 for the smallest Fibonacci number
/// F(n) not below them.
fn fibonacci_steps(points: u32) -> u32 {
    let (mut n, mut a, mut b) = (2u32, 1u64, 1u64);
    while b < u64::from(points) {
        (a, b, n) = (b, a + b, n + 1);
    }
    n - 2
}

fn fibonacci(n: u32) -> f64 {
    (0..n).fold((0.0, 1.0), |(a, b), _| (b, a + b)).0
}

/// Minimises over [a, b]: each step keeps the side with the smaller value and reuses one evaluation. Returns
/// (place, value).
fn fibonacci_search(
    mut a: f64,
    mut b: f64,
    steps: u32,
    energy: impl Fn(f64) -> Result<f64, NodeError>,
) -> Result<(f64, f64), NodeError> {
    let part = |n: u32, a: f64, b: f64| a + fibonacci(n) / fibonacci(n + 2) * (b - a);
    let (mut left, mut right) = (part(steps, a, b), b - (part(steps, a, b) - a));
    let (mut at_left, mut at_right) = (energy(left)?, energy(right)?);
    for n in (1..steps).rev() {
        if at_left <= at_right {
            (b, right, at_right) = (right, left, at_left);
            left = part(n, a, b);
            at_left = energy(left)?;
        } else {
            (a, left, at_left) = (left, right, at_right);
            right = b - (part(n, a, b) - a);
            at_right = energy(right)?;
        }
    }
    Ok(if at_left <= at_right { (left, at_left) } else { (right, at_right) })
}

/// One frame with the events around it.
struct Scene {
    width: usize,
    height: usize,
    /// Blurred frame scaled to [0, 1].
    blurred: Vec<f64>,
    /// What is added to light before its logarithm is taken, on the scale of `blurred`.
    offset: f64,
    exposures: Vec<Exposure>,
    /// Per pixel: times and signs.
    events: Vec<Vec<(i64, f64)>>,
    event_edges: Vec<f64>,
}

/// What a scene is made with.
#[derive(Clone, Copy)]
struct About {
    /// Subtracted from every stamp.
    shift_ns: i64,
    /// DN.
    black: f64,
    /// DN above black that stand for the 1 of log(1 + I); 0 for log I.
    offset_dn: f64,
    /// Of an event's weight.
    decay_s: f64,
}

impl Scene {
    fn new(
        frames: &FrameSequence,
        events: &EventBand,
        l: usize,
        About { shift_ns, black, offset_dn, decay_s }: About,
    ) -> Result<Scene, NodeError> {
        let meta = &frames.meta;
        let (width, height) = (meta.extent.width as usize, meta.extent.height as usize);
        let block = frames.read(l..l + 1, frames.rows())?;
        let above: Vec<f64> = block
            .dn
            .iter()
            .map(|dn| if dn.is_finite() { (f64::from(*dn) - black).max(0.0) } else { 0.0 })
            .collect();
        let peak = above.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let exposures: Vec<Exposure> =
            (0..meta.extent.height).map(|row| meta.times.exposure(l, row)).collect();
        let mut per_pixel = vec![Vec::new(); width * height];
        let mut event_picture = vec![0.0; width * height];
        for y in 0..height {
            let row = events.row(y as u32);
            let middle = exposures[y].mid().0;
            for k in 0..row.len() {
                let (t, sign) = (row.t[k] - shift_ns, Polarity::from_bit(row.on[k]).sign());
                let pixel = y * width + row.x[k] as usize;
                if (exposures[y].start.0..exposures[y].end.0).contains(&t) {
                    per_pixel[pixel].push((t, sign));
                }
                event_picture[pixel] += sign * libm::exp(-((t - middle).abs() as f64 * 1e-9) / decay_s);
            }
        }
        let event_edges = binary_edges(&event_picture, width, height);
        Ok(Scene {
            width,
            height,
            blurred: above.iter().map(|v| v / peak).collect(),
            offset: offset_dn / peak,
            exposures,
            events: per_pixel,
            event_edges,
        })
    }

    /// Relief of the latent picture less the agreement of its edges with the events'.
    fn energy(&self, contrast: f64, lambda: f64) -> f64 {
        let latent = self.latent(contrast);
        let relief: f64 = sobel(&latent, self.width, self.height).iter().sum();
        let agreement: f64 = binary_edges(&latent, self.width, self.height)
            .iter()
            .zip(&self.event_edges)
            .map(|(a, b)| a * b)
            .sum();
        lambda * relief - agreement
    }

    /// The latent picture in the middle of the exposure, clipped to [0, 1.1].
    fn latent(&self, contrast: f64) -> Vec<f64> {
        let (mut t, mut light) = (Vec::new(), Vec::new());
        (0..self.width * self.height)
            .map(|pixel| {
                let exposure = self.exposures[pixel / self.width];
                let middle = exposure.mid().0;
                t.clear();
                light.clear();
                t.push(exposure.start.0);
                light.push(1.0);
                let mut log_light = 0.0;
                for (at, sign) in &self.events[pixel] {
                    log_light += sign * contrast;
                    t.push(*at);
                    light.push(libm::exp(log_light));
                }
                let mean = HeldTrack::new(&t, &light).integral(exposure) / exposure.seconds();
                let held = t.partition_point(|&at| at <= middle).saturating_sub(1);
                ((self.blurred[pixel] + self.offset) * light[held] / mean - self.offset).clamp(0.0, 1.1)
            })
            .collect()
    }
}

/// Magnitude of the 3x3 Sobel gradient; zero on the border.
fn sobel(picture: &[f64], width: usize, height: usize) -> Vec<f64> {
    let mut magnitude = vec![0.0; picture.len()];
    for y in 1..height.saturating_sub(1) {
        for x in 1..width.saturating_sub(1) {
            let at = |dx: usize, dy: usize| picture[(y + dy - 1) * width + x + dx - 1];
            let horizontal = at(2, 0) + 2.0 * at(2, 1) + at(2, 2) - at(0, 0) - 2.0 * at(0, 1) - at(0, 2);
            let vertical = at(0, 2) + 2.0 * at(1, 2) + at(2, 2) - at(0, 0) - 2.0 * at(1, 0) - at(2, 0);
            magnitude[y * width + x] = (horizontal * horizontal + vertical * vertical).sqrt();
        }
    }
    magnitude
}

/// Edges scaled to [0, 1] and cut at mean + (1 - mean) / 3.
fn binary_edges(picture: &[f64], width: usize, height: usize) -> Vec<f64> {
    let magnitude = sobel(picture, width, height);
    let highest = magnitude.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let mean = magnitude.iter().sum::<f64>() / highest / magnitude.len() as f64;
    magnitude.iter().map(|m| f64::from(m / highest >= mean + (1.0 - mean) / 3.0)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_search_finds_the_valley_of_a_parabola() {
        let (place, _) =
            fibonacci_search(0.1, 0.5, fibonacci_steps(200), |c| Ok((c - 0.237) * (c - 0.237))).unwrap();
        // F(13) = 233 points over 0.4: within two of their spacings.
        assert!((place - 0.237).abs() < 2.0 * 0.4 / 233.0, "{place}");
    }

    fn found(per: Per, frames: FrameSequence) -> Vec<f64> {
        use photocurrent_core::testing;
        let node = BaselineContrast { params: Params { per, ..Params::default() } };
        let all = frames.rows();
        let (out, _) = testing::with_context(all, &["contrast"], |cx| {
            node.run(In { events: testing::events(16, 12), frames, sensor: None }, cx)
        });
        match out.unwrap().contrast.column("contrast") {
            Some(Column::Numbers(found)) => found.clone(),
            other => panic!("a column of numbers, not {other:?}"),
        }
    }

    #[test]
    fn a_threshold_per_frame_is_that_of_a_recording_of_the_frame_alone() {
        let frames = photocurrent_core::testing::frames(16, 12, 4);
        let each = found(Per::Frame, frames.clone());
        let alone: Vec<f64> = (0..4).flat_map(|l| found(Per::Sequence, frames.select(vec![l]))).collect();
        assert_eq!(each, alone);
        assert!(
            each.iter().any(|c| *c != each[0]),
            "frames that are all alike would prove nothing: {each:?}"
        );
        assert_eq!(found(Per::Sequence, frames).len(), 1);
    }

    #[test]
    fn light_on_an_offset_takes_the_same_step_for_less() {
        use photocurrent_core::events::{Event, Polarity};
        use photocurrent_core::{Extent, testing};
        let extent = Extent { width: 1, height: 1 };
        // Exposed from 0 to 10 ms; one ON event at 5 ms, which counts as before the middle.
        let frames = testing::captured(extent, vec![Exposure::new(0, 10_000_000)], 0, |_, _, _| 100.0);
        let on = Event { x: 0, y: 0, polarity: Polarity::On, t: 5_000_000, t_in: None };
        let events = testing::stream(extent, vec![on]).read(extent.rows()).unwrap();
        let latent = |offset_dn: f64, contrast: f64| {
            let about = About { shift_ns: 0, black: 0.0, offset_dn, decay_s: 1.0 };
            Scene::new(&frames, &events, 0, about).unwrap().latent(contrast)[0]
        };
        // A tenth more of log I: the mean of 1 and 1.1 is 1.05. Of 100 + 100 DN the same light is 1 and 1.05
        // on the offset, whose mean is 1.025: 2 x 1.05 / 1.025 - 1.
        assert!((latent(0.0, libm::log(1.1)) - 1.1 / 1.05).abs() < 1e-12);
        assert!((latent(100.0, libm::log(1.05)) - (2.0 * 1.05 / 1.025 - 1.0)).abs() < 1e-12);
        let refused = BaselineContrast { params: Params { white: Some(0.0), ..Params::default() } }
            .offset_dn(None)
            .unwrap_err();
        assert_eq!(refused.param.as_deref(), Some("white"));
    }

    #[test]
    fn fifteen_points_take_the_eighth_fibonacci_number() {
        assert_eq!(fibonacci(8), 21.0);
        assert_eq!(fibonacci_steps(15), 6);
    }

    #[test]
    fn a_vertical_step_has_its_edge_where_it_is() {
        let picture: Vec<f64> = (0..25).map(|i| f64::from(i % 5 >= 3)).collect();
        let edges = binary_edges(&picture, 5, 5);
        let columns: Vec<usize> = (0..25).filter(|i| edges[*i] > 0.0).map(|i| i % 5).collect();
        assert!(!columns.is_empty() && columns.iter().all(|x| *x == 2 || *x == 3));
    }
}

//! `baseline/cf`: the complementary filter, continuous in time: events are trusted for fast changes, frames
//! for slow ones.
//!
//! Idea: per pixel, a state l of log(1 + I) moves by a threshold at an event and leaks towards the last
//! frame's log level with a fixed rate w between: l <- exp(-w dt) l + (1 - exp(-w dt)) l_F. The leak
//! high-passes what events say and low-passes what frames say.
//!
//! Source: Scheerlinck, Barnes, Mahony, ACCV 2018, as its authors coded it: offset 1 inside the logarithm, I
//! = 0 for black and 1 for white, the last frame held, cutoff 0.5 Hz (w = 2 pi 0.5 / s). The authors start
//! from l = 0, which takes about a second to forget at that cutoff (`start = "zero"`); the default starts
//! from the first frame. The authors' program ends with the second-to-last frame; this one goes on to the
//! end.
//!
//! Limits: no deblurring; a frame counts at one instant of its exposure. A picture is the state at the middle
//! of a virtual exposure, not a mean over it. The authors' HDR weights and self-tuned thresholds (both off by
//! default there) are not here.

use crate::reconstruct::{In, Intensity, Request, by_rows, events_of, one_contrast_of};
use crate::sampling::{Sampling, scale_seconds};
use photocurrent_core::events::{EventRow, PixelIndex};
use photocurrent_core::quantity::{Duration, Rate};
use photocurrent_core::{
    Context, Decl, Exposure, FrameBlock, FrameSequence, FramesMeta, Grain, Meta, Node, NodeError, PortMetas,
};
use photocurrent_solve::pixel_events::{Stamp, StepRule};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;
use std::sync::Arc;

/// What the state is before the first frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Start {
    /// The first frame's level, from the beginning.
    #[default]
    FirstFrame,
    /// Zero, and leaking to zero until the first frame: the authors' code.
    Zero,
}

/// The instant of its exposure at which a frame counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FrameStamp {
    /// Its start.
    Start,
    /// Its middle.
    #[default]
    Middle,
    /// Its end.
    End,
}

impl FrameStamp {
    fn of(self, exposure: Exposure) -> i64 {
        match self {
            FrameStamp::Start => exposure.start.0,
            FrameStamp::Middle => exposure.mid().0,
            FrameStamp::End => exposure.end.0,
        }
    }
}

/// Parameters of `baseline/cf`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(deny_unknown_fields)]
pub struct Params {
    /// Steady sampling, when nothing is connected to `at`.
    #[serde(flatten)]
    pub sampling: Sampling,
    /// Below this frequency frames are trusted, above it events.
    #[schemars(extend("x-min" = "0.000001 Hz", "x-max" = "1 kHz"))]
    pub cutoff: Rate,
    /// One threshold for both polarities, as a step of log(1 + I); absent = the one at `contrast`, else the
    /// sensor description's two. The authors' default is 0.1.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub threshold: Option<f64>,
    /// DN of white, I = 1; absent = the sensor description's saturation.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub white: Option<f64>,
    /// What the state is before the first frame.
    pub start_from: Start,
    /// The instant of its exposure at which a frame counts.
    pub frame_stamp: FrameStamp,
    /// Which stamp dates an event.
    pub stamp: Stamp,
    /// A constant latency to subtract from every stamp; negative moves events later.
    pub latency: Duration,
}

impl Default for Params {
    fn default() -> Self {
        Params {
            sampling: Sampling::default(),
            cutoff: Rate::new(0.5),
            threshold: None,
            white: None,
            start_from: Start::FirstFrame,
            frame_stamp: FrameStamp::Middle,
            stamp: Stamp::Best,
            latency: Duration::default(),
        }
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// The reconstructed frames, linear DN.
        frames: FrameSequence,
    }
}

/// The node.
pub struct BaselineCf {
    params: Params,
}

impl BaselineCf {
    fn prepare(
        &self,
        request: &Request,
        searched: Option<f64>,
    ) -> Result<(FramesMeta, StepRule, Intensity), NodeError> {
        let params = &self.params;
        let rule =
            request.step_rule("baseline/cf", params.threshold, searched, params.stamp, params.latency)?;
        Ok((request.output(&params.sampling)?, rule, request.intensity("baseline/cf", params.white)?))
    }
}

impl Node for BaselineCf {
    const DECL: Decl = Decl {
        kind: "baseline/cf",
        about: "The complementary filter: events for fast changes, frames for slow ones.",
        revision: 1,
        grain: Grain::Pixel,
        draws: false,
        exports: false,
        sources: &["Scheerlinck, Barnes, Mahony, Continuous-time Intensity Estimation Using Event Cameras, \
                    ACCV 2018, and its authors' code"],
        example: r#"
[nodes.cf]
kind   = "baseline/cf"
in     = { events = "recording.events", frames = "recording.frames", sensor = "sensor" }
params = { rate = "1 kHz", cutoff = "0.5 Hz", threshold = 0.1, white = 255 }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(BaselineCf { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![Meta::Frames(Arc::new(
            self.prepare(&Request::planned(inputs)?, inputs.has("contrast").then_some(1.0))?.0,
        ))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let request = input.request();
        let searched =
            input.contrast.as_deref().map(|table| one_contrast_of(table, "baseline/cf")).transpose()?;
        let (meta, rule, intensity) = self.prepare(&request, searched)?;
        let events = events_of(&input.events, request.frames, cx.rows())?;
        let frames = input.frames.read_rows(cx.rows())?;
        let job = Job { captured: request.frames, output: &meta, params: &self.params, rule, intensity };
        Ok(Out {
            frames: by_rows(cx, meta.clone(), |row| {
                events.with_row(row, |events| job.row(row, &events, &frames))
            })?,
        })
    }
}

struct Job<'a> {
    captured: &'a FramesMeta,
    output: &'a FramesMeta,
    params: &'a Params,
    rule: StepRule,
    intensity: Intensity,
}

impl Job<'_> {
    /// All output frames of one row as [frame][x].
    fn row(&self, row: u32, events: &EventRow, frames: &FrameBlock) -> Vec<f32> {
        let width = self.captured.row_values();
        let index: PixelIndex = events.by_pixel(width as u32);
        let exposures: Vec<Exposure> =
            (0..self.captured.times.len()).map(|l| self.captured.times.exposure(l, row)).collect();
        let stamps: Vec<i64> =
            exposures.iter().map(|exposure| self.params.frame_stamp.of(*exposure)).collect();
        let mut wanted: Vec<(i64, usize)> =
            (0..self.output.times.len()).map(|l| (self.output.times.exposure(l, row).mid().0, l)).collect();
        wanted.sort_unstable();
        let instants: Vec<i64> = wanted.iter().map(|(t, _)| *t).collect();
        let seconds: Vec<f64> = wanted
            .iter()
            .map(|(_, l)| scale_seconds(self.output.scale, self.output.times.exposure(*l, row)))
            .collect();
        let mut picture = vec![0.0; wanted.len() * width];
        let (mut steps, mut levels) = (Vec::new(), Vec::new());
        for x in 0..width {
            steps.clear();
            steps.extend(
                index.pixel(x).iter().map(|&k| (self.rule.time(events, k), self.rule.step(events, k))),
            );
            // In-pixel times need not be in the order of the stamps.
            steps.sort_by_key(|(t, _)| *t);
            levels.clear();
            levels.extend(exposures.iter().enumerate().map(|(l, exposure)| {
                (stamps[l], libm::log1p(self.intensity.of(frames.row(l, row)[x], *exposure)))
            }));
            let mut filter = Filter::new(self.params.cutoff, self.params.start_from, &levels);
            let mut i = 0;
            filter.run(&steps, &levels, &instants, |log_state| {
                picture[wanted[i].1 * width + x] = self.intensity.dn(libm::expm1(log_state), seconds[i]);
                i += 1;
            });
        }
        picture
    }
}

/// One pixel's state.
struct Filter {
    /// Leak, 1/s.
    leak: f64,
    /// log(1 + I).
    state: f64,
    /// The last frame's log(1 + I).
    reference: f64,
    updated_ns: i64,
}

impl Filter {
    /// `levels` are (time in ns, log level) of the frames, in order.
    fn new(cutoff: Rate, start: Start, levels: &[(i64, f64)]) -> Filter {
        let level = match start {
            Start::FirstFrame => levels.first().map_or(0.0, |(_, level)| *level),
            Start::Zero => 0.0,
        };
        // State and reference are equal: until something comes, the time of the last update does not matter.
        Filter { leak: 2.0 * PI * cutoff.hz(), state: level, reference: level, updated_ns: 0 }
    }

    fn advance(&mut self, t_ns: i64) {
        let kept = libm::exp(-self.leak * ((t_ns - self.updated_ns) as f64 * 1e-9));
        self.state = kept * self.state + (1.0 - kept) * self.reference;
        self.updated_ns = t_ns;
    }

    /// Gives the state at every instant, in order. All three lists are in time order; an event or frame at an
    /// instant counts.
    fn run(
        &mut self,
        events: &[(i64, f64)],
        frames: &[(i64, f64)],
        instants: &[i64],
        mut give: impl FnMut(f64),
    ) {
        let first = [events.first().map(|e| e.0), frames.first().map(|f| f.0), instants.first().copied()];
        self.updated_ns = first.into_iter().flatten().min().unwrap_or(0);
        let (mut event, mut frame) = (0, 0);
        for &t in instants {
            loop {
                let next_frame = frames.get(frame).map_or(i64::MAX, |f| f.0);
                let next_event = events.get(event).map_or(i64::MAX, |e| e.0);
                if next_frame.min(next_event) > t {
                    break;
                }
                if next_frame <= next_event {
                    self.advance(next_frame);
                    self.reference = frames[frame].1;
                    frame += 1;
                } else {
                    self.advance(next_event);
                    self.state += events[event].1;
                    event += 1;
                }
            }
            self.advance(t);
            give(self.state);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::reference;
    use super::*;
    use photocurrent_core::events::{Event, Polarity};
    use photocurrent_core::{Extent, testing};

    /// Instants of the authors' output that are kept, us.
    const INSTANTS_US: [i64; 5] = [1408, 11_419, 21_428, 121_472, 251_544];

    /// The step that an instant's picture of the authors lacks: they write it at the first event of that
    /// stamp, and others may share the stamp.
    fn not_yet(clip: &[Vec<(i64, f64)>], instant: usize, pixel: usize) -> f64 {
        let at_instant = |list: &[(i64, f64)]| {
            list.iter()
                .find(|(us, _)| *us == INSTANTS_US[instant])
                .map(|(_, sign)| sign * reference::CONTRAST)
        };
        let first = clip
            .iter()
            .position(|list| at_instant(list).is_some())
            .expect("a picture is written at an event");
        if pixel > first { at_instant(&clip[pixel]).unwrap_or(0.0) } else { 0.0 }
    }

    #[test]
    fn the_state_is_that_of_the_authors_program() {
        let expected = reference::pictures("cf_log_state.f64");
        let frames = reference::frames();
        let block = frames.read_rows(frames.rows()).unwrap();
        let instants = INSTANTS_US.map(|us| us * 1000);
        let clip = reference::events();
        for (pixel, events) in clip.iter().enumerate() {
            let steps: Vec<(i64, f64)> =
                events.iter().map(|(us, sign)| (us * 1000, sign * reference::CONTRAST)).collect();
            let level = |l: usize| libm::log(1.0 + f64::from(block.frame(l)[pixel]) / 255.0);
            let levels: Vec<(i64, f64)> =
                (0..8).map(|l| (20_000_000 + l as i64 * 40_000_000, level(l))).collect();
            let mut found = Vec::new();
            Filter::new(Rate::new(0.5), Start::Zero, &levels)
                .run(&steps, &levels, &instants, |state| found.push(state));
            for (instant, state) in found.iter().enumerate() {
                // The authors' clock is in seconds of a 64-bit number: 5e-13 is what it rounds.
                let difference = (state - not_yet(&clip, instant, pixel) - expected[instant][pixel]).abs();
                assert!(difference < 1e-9, "pixel {pixel}, instant {instant}: {difference:e}");
            }
        }
    }

    #[test]
    fn the_node_gives_the_authors_picture_in_digital_numbers() {
        let expected = reference::pictures("cf_log_state.f64");
        let at = testing::captured(
            reference::EXTENT,
            INSTANTS_US[1..]
                .iter()
                .map(|us| Exposure::new(us * 1000 - 10_000_000, us * 1000 + 10_000_000))
                .collect(),
            0,
            |_, _, _| 0.0,
        );
        let params = Params {
            threshold: Some(reference::CONTRAST),
            white: Some(255.0),
            start_from: Start::Zero,
            ..Params::default()
        };
        let input = In {
            events: reference::stream(),
            frames: reference::frames(),
            sensor: None,
            contrast: None,
            at: Some(at),
        };
        let (out, _) = testing::with_context(reference::EXTENT.rows(), &["frames"], |cx| {
            BaselineCf { params }.run(input, cx)
        });
        let frames = out.unwrap().frames;
        let block = frames.read_rows(frames.rows()).unwrap();
        let clip = reference::events();
        for l in 0..4 {
            let dn: Vec<f64> = block.frame(l).iter().map(|dn| f64::from(*dn)).collect();
            let state = |pixel: usize| expected[l + 1][pixel] + not_yet(&clip, l + 1, pixel);
            let authors: Vec<f64> =
                (0..reference::PIXELS).map(|pixel| libm::expm1(state(pixel)) * 255.0).collect();
            // 32-bit digital numbers up to 500 round by 3e-5.
            assert!(reference::apart(&dn, &authors) < 4e-5);
        }
    }

    #[test]
    fn a_pixel_without_events_leaks_to_the_next_frame() {
        // After one time constant, 1 - 1/e of the way from log 1.5 to log 1.75.
        let extent = Extent { width: 1, height: 1 };
        let exposures = vec![Exposure::new(-1_000_000, 1_000_000), Exposure::new(99_000_000, 101_000_000)];
        let frames = testing::captured(extent, exposures, 0, |l, _, _| [50.0, 75.0][l]);
        let cutoff = Rate::new(10.0 / (2.0 * PI));
        let sampling =
            Sampling { rate: Rate::new(5.0), end: Some(Duration::new(201_000_000)), ..Sampling::default() };
        let params =
            Params { cutoff, sampling, threshold: Some(0.1), white: Some(100.0), ..Params::default() };
        let events = testing::stream(
            extent,
            vec![Event { x: 0, y: 0, polarity: Polarity::On, t: 300_000_000, t_in: None }],
        );
        let (out, _) = testing::with_context(extent.rows(), &["frames"], |cx| {
            BaselineCf { params }.run(In { events, frames, sensor: None, contrast: None, at: None }, cx)
        });
        let dn = out.unwrap().frames.read_rows(extent.rows()).unwrap().dn;
        let (low, high, left) = (libm::log(1.5), libm::log(1.75), libm::exp(-1.0));
        let expected = 100.0 * (libm::exp(low * left + high * (1.0 - left)) - 1.0);
        assert!(
            (f64::from(dn[0]) - 50.0).abs() < 1e-4 && (f64::from(dn[1]) - expected).abs() < 1e-4,
            "{dn:?}, {expected}"
        );
    }

    #[test]
    fn white_must_come_from_somewhere() {
        let frames = reference::frames();
        let request = Request { frames: &frames.meta, events: None, at: None, sensor: None };
        let node = BaselineCf { params: Params { threshold: Some(0.1), ..Params::default() } };
        assert_eq!(
            node.prepare(&request, None).err().and_then(|error| error.param).as_deref(),
            Some("white")
        );
    }
}

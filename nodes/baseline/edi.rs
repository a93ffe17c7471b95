//! `baseline/edi`: the event-based double integral, exactly.
//!
//! Idea: between events a pixel's log light is constant, at an event it moves by one threshold. So the latent picture is known up to one
//! factor per pixel, `L(t) = L(f) exp(E(t))`, and the blurred frame, which is the mean of L over its exposure, fixes the factor:
//! `L(f) = B / mean(exp(E))`. Both integrals are piecewise constant and taken exactly, per pixel and with the row's own exposure.
//! A frame elsewhere in time starts from the captured frame nearest to it.
//!
//! What its authors leave implicit stands in the open: the exposure is the recording's, the threshold is the sensor description's, a given number or one found by
//! `baseline/contrast`, and a constant latency can be taken off the stamps. Limits: no front-end delay, no readout latency, no refractory period.

use crate::pixel_events::{Stamp, StepRule};
use crate::reconstruct::{Request, black_level, by_rows, contrast_of, nearest_frame};
use crate::sampling::{Sampling, scale_seconds};
use photocurrent_core::events::{EventRow, PixelIndex};
use photocurrent_core::quantity::Duration;
use photocurrent_core::{Context, Decl, EventStream, Exposure, FrameBlock, FrameSequence, FramesMeta, Grain, Meta, Node, NodeError, PortMetas, Sensor, Table};
use photocurrent_sensor::exposure::{ExposureCursor, HeldTrack};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Parameters of `baseline/edi`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(deny_unknown_fields)]
pub struct Params {
    /// Steady sampling, when nothing is connected to `at`.
    #[serde(flatten)]
    pub sampling: Sampling,
    /// One threshold for both polarities, natural-log units; absent = the one at `contrast`, else the sensor description's two.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub threshold: Option<f64>,
    /// Which stamp dates an event.
    pub stamp: Stamp,
    /// A constant latency to take off every stamp; negative moves events later.
    pub latency: Duration,
    /// Length over which a captured frame's blur is taken, around the middle of its exposure; absent = its exposure as recorded.
    #[schemars(extend("x-min" = "1 ns"))]
    pub blur: Option<Duration>,
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Events; compensated steps are used where a node before made them.
        events: EventStream,
        /// Captured frames.
        frames: FrameSequence,
        /// Thresholds, black level, clock offset.
        sensor: Option<Arc<Sensor>>,
        /// A table with the column `contrast`, from `baseline/contrast`.
        contrast: Option<Arc<Table>>,
        /// Frames whose exposures, row time and scale are to be imitated.
        at: Option<FrameSequence>,
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
pub struct BaselineEdi {
    params: Params,
}

impl BaselineEdi {
    fn rule(&self, request: &Request, searched: Option<f64>) -> Result<StepRule, NodeError> {
        request.step_rule("baseline/edi", self.params.threshold, searched, self.params.stamp, self.params.latency)
    }
}

impl Node for BaselineEdi {
    const DECL: Decl = Decl {
        kind: "baseline/edi",
        about: "The event-based double integral, exactly, with threshold, exposure and latency in the open.",
        revision: 1,
        grain: Grain::Pixel,
        draws: false,
        exports: false,
        sources: &["Pan et al., Bringing a Blurry Frame Alive at High Frame-Rate with an Event Camera, CVPR 2019"],
        example: r#"
[nodes.edi]
kind   = "baseline/edi"
in     = { events = "recording.events", frames = "recording.frames", sensor = "sensor" }
params = { rate = "1 kHz", latency = "40 us" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(BaselineEdi { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let request = Request::planned(inputs)?;
        self.rule(&request, inputs.has("contrast").then_some(1.0))?;
        Ok(vec![Meta::Frames(Arc::new(request.output(&self.params.sampling)?))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let request = Request::connected(&input.frames, Some(&input.events), &input.at, &input.sensor);
        let searched = input.contrast.as_deref().map(contrast_of).transpose()?.map(|values| values[0]);
        let rule = self.rule(&request, searched)?;
        let meta = request.output(&self.params.sampling)?;
        let job = Job { captured: request.frames, output: &meta, rule, black: black_level(request.sensor), blur: self.params.blur };
        let events = input.events.read(cx.rows())?;
        let frames = input.frames.read_rows(cx.rows())?;
        Ok(Out { frames: by_rows(cx, meta.clone(), |row| Ok(job.row(row, &events.row(row), &frames)))? })
    }
}

struct Job<'a> {
    captured: &'a FramesMeta,
    output: &'a FramesMeta,
    rule: StepRule,
    black: f64,
    blur: Option<Duration>,
}

impl Job<'_> {
    /// The interval over which a captured frame is taken to be the mean of the light.
    fn blurred_over(&self, exposure: Exposure) -> Exposure {
        self.blur.map_or(exposure, |blur| {
            let start = exposure.mid().0 - blur.ns() / 2;
            Exposure::new(start, start + blur.ns())
        })
    }

    /// All output frames of one row as [frame][x].
    fn row(&self, row: u32, events: &EventRow, frames: &FrameBlock) -> Vec<f32> {
        self.latent(row, events, frames).into_iter().map(|dn| dn as f32).collect()
    }

    /// The same before it is rounded to 32 bits.
    fn latent(&self, row: u32, events: &EventRow, frames: &FrameBlock) -> Vec<f64> {
        let width = self.captured.extent.width as usize;
        let index = events.by_pixel(self.captured.extent.width);
        let outputs: Vec<Exposure> = (0..self.output.times.len()).map(|l| self.output.times.exposure(l, row)).collect();
        let starts_from: Vec<usize> = outputs.iter().map(|e| nearest_frame(self.captured, row, e.mid().0)).collect();
        let mut picture = vec![0.0; outputs.len() * width];
        let mut relative = RelativeLight::default();
        let mut level = Vec::new();
        for x in 0..width {
            relative.fill(&self.rule, events, &index, x);
            let mut cursor = ExposureCursor::new(HeldTrack::new(&relative.t, &relative.light));
            level.clear();
            level.extend((0..self.captured.times.len()).map(|l| {
                let exposure = self.captured.times.exposure(l, row);
                let above_black = f64::from(frames.row(l, row)[x]) - self.black;
                // The mean over the blur, as charge of the exposure: with the recorded exposure, the plain integral.
                let mean = cursor.integral(self.blurred_over(exposure)) / self.blurred_over(exposure).seconds();
                above_black / (mean * exposure.seconds())
            }));
            for (l, exposure) in outputs.iter().enumerate() {
                let mean = cursor.integral(*exposure) / exposure.seconds();
                let dn = level[starts_from[l]] * mean * scale_seconds(self.output.scale, *exposure);
                picture[l * width + x] = self.black + dn;
            }
        }
        picture
    }
}

/// One pixel's light up to a factor: exp of the summed steps, held between events.
#[derive(Default)]
struct RelativeLight {
    t: Vec<i64>,
    light: Vec<f64>,
}

/// Summed steps are kept inside this, so that their exponentials stay finite: e^600 is far beyond any sensor.
const LOG_LIGHT_LIMIT: f64 = 600.0;

impl RelativeLight {
    fn fill(&mut self, rule: &StepRule, events: &EventRow, index: &PixelIndex, x: usize) {
        self.t.clear();
        self.light.clear();
        // Before the first event the light is 1, whenever that event came.
        self.t.push(i64::MIN / 4);
        self.light.push(1.0);
        let mut log_light = 0.0;
        for &k in index.pixel(x) {
            log_light = f64::clamp(log_light + rule.step(events, k), -LOG_LIGHT_LIMIT, LOG_LIGHT_LIMIT);
            // Stamps of one pixel may fall back by their jitter; a step never comes before the one before it.
            let t = rule.time(events, k).max(*self.t.last().expect("holds the start"));
            self.t.push(t);
            self.light.push(libm::exp(log_light));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::reference;
    use super::*;
    use photocurrent_core::events::{Event, Polarity};
    use photocurrent_core::quantity::Rate;
    use photocurrent_core::{Extent, testing};

    const ONE: Extent = Extent { width: 1, height: 1 };

    fn on(t: i64) -> Event {
        Event { x: 0, y: 0, polarity: Polarity::On, t, t_in: None }
    }

    fn edi(params: Params, events: Vec<Event>, exposures: Vec<Exposure>, dn: f32) -> Vec<f32> {
        let frames = testing::captured(ONE, exposures, 0, |_, _, _| dn);
        let input = In { events: testing::stream(ONE, events), frames, sensor: None, contrast: None, at: None };
        let (out, _) = testing::with_context(ONE.rows(), &["frames"], |cx| BaselineEdi { params }.run(input, cx));
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
    fn a_longer_blur_takes_in_events_outside_the_exposure() {
        // Exposed from 2 to 4 ms without an event, but blurred over 0 to 6 ms with a doubling at 5 ms: the mean is (5 + 2) / 6 of L.
        let blurred = Params { blur: Some(Duration::new(6_000_000)), ..params(1000.0) };
        let dn = edi(blurred, vec![on(5_000_000)], vec![Exposure::new(2_000_000, 4_000_000)], 70.0);
        assert!((dn[0] - 60.0).abs() < 1e-3, "{dn:?}");
    }

    /// The reference works on 1 + I and takes the latent picture at the instant of the middle; the node gives means over exposures of 2 ns here, and stamps
    /// are whole microseconds, so that an event at the middle counts as after it when the exposure ends there.
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
        let scaled = FramesMeta { scale: photocurrent_core::FrameScale::Nominal { exposure_ns: 20_000_000 }, ..(*at.meta).clone() };
        let request = Request { frames: &captured.meta, events: None, at: Some(&scaled), sensor: Some(&sensor) };
        let rule = StepRule { threshold_on: reference::CONTRAST, threshold_off: reference::CONTRAST, stamp: Stamp::Best, shift_ns: 0 };
        let output = request.output(&Sampling::default()).unwrap();
        let job = Job { captured: &captured.meta, output: &output, rule, black: -255.0, blur: None };
        let events = reference::stream().read(reference::EXTENT.rows()).unwrap();
        let block = captured.read_rows(captured.rows()).unwrap();
        for row in reference::EXTENT.rows().iter() {
            let picture = job.latent(row, &events.row(row), &block);
            for (authors, l) in expected.iter().zip(&kept) {
                let latent: Vec<f64> = picture[l * 48..][..48].iter().map(|dn| dn / 255.0).collect();
                let apart = reference::apart(&latent, &authors[row as usize * 48..][..48]);
                assert!(apart < 1e-9, "frame {l}, row {row}: {apart:e}");
            }
        }
    }

    #[test]
    fn a_threshold_must_come_from_somewhere() {
        let node = BaselineEdi { params: Params::default() };
        let events = testing::stream(ONE, vec![]);
        let frames = testing::frames(1, 1, 1);
        let request = Request { frames: &frames.meta, events: Some(&events.meta), at: None, sensor: None };
        assert_eq!(node.rule(&request, None).unwrap_err().param.as_deref(), Some("threshold"));
        assert_eq!(node.rule(&request, Some(0.3)).unwrap().threshold_off, 0.3);
    }
}

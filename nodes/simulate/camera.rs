//! The simulated camera: what a described sensor makes of the light on one row of pixels.
//!
//! Everything the simulators share: when frames are exposed, how charge becomes a noisy whole number, how a
//! pixel's events come about ([`photocurrent_sensor::forward`]) with the effects of the sensor description.
//! Every pixel has its own random numbers, so row bands do not matter.
//!
//! An effect that couples all pixels (a queue on their way out) does nothing until [`Camera::inform`] gives
//! it the load.
//!
//! Limits: photon noise only in the frames; the random part of the readout latency is drawn per event.

use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::quantity::{Duration, Rate};
use photocurrent_core::random::Random;
use photocurrent_core::{
    Colour, DataType, EventsMeta, Exposure, Extent, FrameScale, FrameTimes, FramesMeta, NodeError, Sensor,
    TimeSpan,
};
use photocurrent_sensor::array::{self, Array};
use photocurrent_sensor::effects::{ArrayEvent, Effect, Site, from_description};
use photocurrent_sensor::exposure::DigitalNumber;
use photocurrent_sensor::forward::neighbours::halo;
use photocurrent_sensor::forward::{Fired, LinearLight, TOLERANCE};
use photocurrent_sensor::model::Model;
use photocurrent_solve::co_located::{channel_gains, gain_of};
use photocurrent_solve::pixel_events::StepRule;
/// When frames are taken, and how late events come; stated by the node, not by the sensor.
#[derive(Clone, Copy, Debug)]
pub struct Timing {
    /// Captured frames per second.
    pub frame_rate: Rate,
    /// Exposure of a captured frame.
    pub exposure: Duration,
    /// Mean of the random part of the readout latency.
    pub latency_spread: Duration,
}

impl Timing {
    /// Exposures, from the start of `span` on, of the frames whose last row ends inside it.
    ///
    /// # Errors
    /// When the exposure does not fit the frame period, or no frame fits the span.
    pub fn frame_times(
        &self,
        span: TimeSpan,
        height: u32,
        row_time_ns: i64,
    ) -> Result<FrameTimes, NodeError> {
        let (exposure, period) = (self.exposure.ns(), 1e9 / self.frame_rate.hz());
        if exposure as f64 > period {
            return Err(NodeError::usage(format!(
                "an exposure of {} does not fit the frame period of {:.0} us",
                self.exposure,
                period / 1e3
            ))
            .note(format!("the period is one over `frame_rate = \"{}\"`", self.frame_rate))
            .hint("make `exposure` shorter or `frame_rate` lower")
            .param("exposure"));
        }
        let last_row = row_time_ns * i64::from(height - 1);
        let starts = (0..).map(|l| span.start.0 + (f64::from(l) * period).round() as i64);
        let exposures: Vec<Exposure> = starts
            .take_while(|start| start + exposure + last_row <= span.end.0)
            .map(|start| Exposure::new(start, start + exposure))
            .collect();
        if exposures.is_empty() {
            return Err(NodeError::usage(format!("no frame fits into {}", Duration::new(span.length_ns())))
                .hint("make `duration` longer or `exposure` shorter")
                .param("duration"));
        }
        Ok(FrameTimes::new(exposures, row_time_ns)?)
    }
}

/// A described sensor, ready to look.
pub struct Camera {
    /// What its events will look like.
    pub events: EventsMeta,
    /// What its frames will look like.
    pub frames: FramesMeta,
    model: Model,
    effects: Vec<Box<dyn Effect>>,
    /// Which of the effects couple all pixels.
    coupling: Vec<bool>,
    channel_gains: [f64; 3],
    span: TimeSpan,
    seed: u64,
}

impl Camera {
    /// From a description, with events and frames of the given extents.
    ///
    /// # Errors
    /// When it leaves out what a simulation needs, its effects are not understood, pixels would be blind for
    /// longer than there is light, or the frames do not fit. `who` is the asker.
    pub fn new(
        sensor: &Sensor,
        timing: &Timing,
        (events, frames, colour): (Extent, Extent, Colour),
        span: TimeSpan,
        seed: u64,
        who: &str,
    ) -> Result<Camera, NodeError> {
        let stated = [
            ("front_end.tau_0", sensor.front_end.tau_0.is_some()),
            ("front_end.alpha", sensor.front_end.alpha.is_some()),
            ("readout.refractory", sensor.readout.refractory.is_some()),
            ("frames.gain", sensor.frames.gain.is_some()),
            ("frames.row_time", sensor.frames.row_time.is_some()),
        ];
        sensor.need_all(&[StepRule::needs(sensor).as_slice(), &stated].concat(), who)?;
        let effects = from_description(&sensor.effects)
            .map_err(|why| NodeError::usage(why).hint("`photocurrent effects` lists what there is"))?;
        if let Some(refractory) =
            sensor.readout.refractory.filter(|refractory| refractory.ns() > span.length_ns())
        {
            let message = format!(
                "`readout.refractory` is {refractory}, and the light lasts {}",
                Duration::new(span.length_ns())
            );
            return Err(NodeError::usage(message)
                .note(
                    "a pixel is blind for its refractory period after each event: no second one could be \
                       seen",
                )
                .hint(
                    "check the unit of `readout.refractory` in the sensor description, usually 1 us to 10 \
                       ms, or make the light longer",
                )
                .blames(DataType::Sensor));
        }
        let coupling = effects.iter().map(|effect| effect.informed(&[]).is_some()).collect();
        let mut model = Model::of(sensor);
        model.pixel.latency_spread_ns = timing.latency_spread.ns() as f64;
        let row_time_ns = model.row_time_ns;
        let times = timing.frame_times(span, frames.height, row_time_ns)?;
        let frames = FramesMeta { extent: frames, colour, times, scale: FrameScale::Captured };
        let moved = photocurrent_solve::pixel_events::clock_offset(sensor)?.offset_ns;
        let events = EventsMeta {
            extent: events,
            span: Some(span.moved(moved)),
            has_t_in: true,
            has_step: false,
            t_resolution_ns: None,
            count_hint: None,
        };
        Ok(Camera {
            events,
            frames,
            model,
            effects,
            coupling,
            channel_gains: channel_gains(sensor)?,
            span,
            seed,
        })
    }

    /// Rows above and below whose light reaches a pixel through its effects.
    pub fn halo(&self) -> u32 {
        halo(&self.effects)
    }

    /// The effects of the description, in the order of the chain.
    pub fn effects(&self) -> &[Box<dyn Effect>] {
        &self.effects
    }

    /// The id of an effect that couples all pixels, if the description has one: then no row can be simulated
    /// before [`Camera::inform`].
    pub fn couples(&self) -> Option<&'static str> {
        self.effects.iter().zip(&self.coupling).find_map(|(effect, couples)| couples.then(|| effect.id()))
    }

    /// Gives the effects that couple all pixels what the whole array does; `load` is in order of true
    /// off-pixel time.
    pub fn inform(&mut self, load: &[ArrayEvent]) {
        array::inform(&mut self.effects, load);
    }

    /// How much later than without load an event of pixel (x, y) that fires at `t_in_ns` resets its pixel,
    /// nanoseconds.
    pub fn delay_ns(&self, x: u32, y: u32, t_in_ns: i64) -> i64 {
        let site = self.site(self.events.extent, x, y);
        let coupling = self.effects.iter().zip(&self.coupling).filter(|(_, couples)| **couples);
        // Load and instant say it all: the numbers of this stream stay unused ([`Effect::informed`]).
        let latencies =
            coupling.map(|(effect, _)| effect.latency(&site, &mut Random::new(self.seed, &[]), t_in_ns));
        latencies.map(|latency| latency.shown_ns + latency.hidden_ns).sum()
    }

    fn site(&self, extent: Extent, x: u32, y: u32) -> Site {
        Site { x, y, width: extent.width, height: extent.height, seed: self.seed }
    }

    /// Everything that pixel (x, y) fires in `seen`, the light of the event path: lost events, and those that
    /// leave after the end, too.
    pub fn fired(&self, x: u32, y: u32, seen: &LinearLight) -> Vec<Fired> {
        self.array().fired(&self.site(self.events.extent, x, y), seen, self.draws(x, y))
    }

    fn array(&self) -> Array<'_> {
        let span = (self.span.start.0, self.span.end.0);
        Array { model: &self.model, effects: &self.effects, tolerance: TOLERANCE, span }
    }

    /// The random numbers of the events of pixel (x, y).
    fn draws(&self, x: u32, y: u32) -> Random {
        Random::new(self.seed, &[x.into(), y.into(), 1])
    }

    /// Appends what event pixel (x, y) records of `seen`, the light of the event path.
    pub fn record(&self, x: u32, y: u32, seen: &LinearLight, events: &mut Vec<Event>) {
        for event in self.array().recorded(&self.site(self.events.extent, x, y), seen, self.draws(x, y)) {
            let polarity = if event.polarity > 0 { Polarity::On } else { Polarity::Off };
            events.push(Event {
                x: x as u16,
                y: y as u16,
                polarity,
                t: event.t_off_ns,
                t_in: Some(event.t_in_ns),
            });
        }
    }

    /// Frame values at `value` (`x * channels + channel`) of row `y`, from the light that it sees.
    pub fn frame_values(&self, value: u32, y: u32, light: &LinearLight) -> Vec<f64> {
        let gain = gain_of(self.model.number.gain, &self.channel_gains, self.frames.colour, value, y);
        let number = DigitalNumber { gain, ..self.model.number };
        let exposures: Vec<Exposure> =
            (0..self.frames.times.len()).map(|l| self.frames.times.exposure(l, y)).collect();
        let mut random = Random::new(self.seed, &[value.into(), y.into(), 2]);
        let site = self.site(self.frames.extent, value / self.frames.channels(), y);
        let exact = self.array().frame_values(&site, light, number, &exposures);
        exact.into_iter().map(|dn| recorded(&self.model, dn, &mut random)).collect()
    }
}

/// From an exact digital number to a recorded one: shot noise, read noise, saturation, whole numbers.
fn recorded(model: &Model, exact: f64, random: &mut Random) -> f64 {
    // Photon counts are large enough for the normal limit of the Poisson distribution.
    let signal = (exact - model.number.black_level).max(0.0);
    let shot = if model.dn_per_electron > 0.0 {
        (signal * model.dn_per_electron).sqrt() * random.normal()
    } else {
        0.0
    };
    let read = model.read_noise_dn * random.normal();
    (exact + shot + read).round().clamp(0.0, model.saturation_dn)
}

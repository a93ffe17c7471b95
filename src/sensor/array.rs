//! One pixel of a simulated array: what it records of the light on it, with random numbers of its own.
//!
//! Everything that simulators of arrays share: which light, which pixels and how frame values are rounded is
//! theirs.
//! An effect that couples all pixels (a queue on their way out) does nothing until [`inform`] gives it the
//! load.

use crate::effects::{ArrayEvent, Effect, PixelEvent, Site};
use crate::exposure::DigitalNumber;
use crate::forward::{Chain, Fired, FrameReadout, LinearLight, PixelNoise, read_frames, simulate};
use crate::model::Model;
use photocurrent_core::Exposure;
use photocurrent_core::random::Random;

/// What all pixels of an array have in common.
#[derive(Clone, Copy)]
pub struct Array<'a> {
    /// The stated sensor.
    pub model: &'a Model,
    /// Effects, in the order of the catalogue.
    pub effects: &'a [Box<dyn Effect>],
    /// Error allowed per step of front ends without a closed form ([`Chain::tolerance`]).
    pub tolerance: f64,
    /// First and last instant, ns.
    pub span: (i64, i64),
}

impl Array<'_> {
    /// Everything that the pixel fires in `seen`, the light of the event path: lost events, and those that
    /// leave after the end, too.
    pub fn fired(&self, site: &Site, seen: &LinearLight<'_>, random: Random) -> Vec<Fired> {
        let chain = Chain {
            pixel: self.model.pixel,
            reset: self.model.reset,
            effects: self.effects,
            tolerance: self.tolerance,
        };
        let mut noise = Noise { random, sigma: self.model.threshold_noise };
        simulate(&chain, site, seen, self.span.0, self.span.1, &mut noise)
    }

    /// What is recorded of that: what leaves the array after the end is no part of the recording.
    pub fn recorded(
        &self,
        site: &Site,
        seen: &LinearLight<'_>,
        random: Random,
    ) -> impl Iterator<Item = PixelEvent> + use<> {
        let end_ns = self.span.1;
        self.fired(site, seen, random)
            .into_iter()
            .filter(move |fired| fired.left_ns < end_ns)
            .filter_map(|fired| fired.recorded)
    }

    /// Frame values of the pixel at these exposures of its row, exact, from the light on it
    /// ([`read_frames`]).
    pub fn frame_values(
        &self,
        site: &Site,
        own: &LinearLight<'_>,
        number: DigitalNumber,
        exposures: &[Exposure],
    ) -> Vec<f64> {
        let readout = FrameReadout {
            number,
            saturation: self.model.saturation_dn,
            row_time_ns: self.model.row_time_ns,
        };
        read_frames(&readout, self.effects, site, own, exposures)
    }
}

/// Gives the effects that couple all pixels what the whole array does; `load` is in order of true off-pixel
/// time.
pub fn inform(effects: &mut [Box<dyn Effect>], load: &[ArrayEvent]) {
    for effect in effects {
        if let Some(informed) = effect.informed(load) {
            *effect = informed;
        }
    }
}

/// A random part of the latency, and thresholds that vary from event to event.
struct Noise {
    random: Random,
    sigma: f64,
}

impl PixelNoise for Noise {
    fn uniform(&mut self) -> f64 {
        self.random.uniform()
    }

    fn threshold_offset(&mut self) -> f64 {
        if self.sigma == 0.0 { 0.0 } else { self.sigma * self.random.normal() }
    }
}

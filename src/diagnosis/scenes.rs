//! Scenes and sensors simulated for training: random [sketches](photocurrent_scene::closed::sketch) before
//! random sensors; light, speed, thresholds, time constants, reset rules, exposures and stamps over the
//! ranges of cameras that such recordings are made with.
//!
//! Everything follows from a seed. Limits: grey, no flicker, no noise of the light.

use crate::candidates::Trial;
use crate::curves::LogLightCurves;
use crate::record::{SimulatedConditions, record};
use crate::sample::PixelSample;
use photocurrent_core::quantity::Duration;
use photocurrent_core::random::Random;
use photocurrent_core::sensor::Reset;
use photocurrent_core::{Exposure, Extent, FrameTimes, Sensor};
use photocurrent_scene::case::{Case, CaseFrames, PixelEvents};
use photocurrent_scene::closed::sketch::{Sketch, SketchMotion};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// A simulated scene before a simulated sensor.
#[derive(Clone, Debug)]
pub struct SimulatedScene {
    /// The scene.
    pub sketch: Sketch,
    sensor: Sensor,
    exposures: Vec<Exposure>,
    resolution_ns: i64,
    extent: Extent,
    span: (i64, i64),
    /// Frame noise that the description does not state: electrons per DN, and read noise, DN.
    noise: Option<(f64, f64)>,
    /// Threshold noise that the description does not state, natural-log units.
    unstated_noise: f64,
    /// Light is taken this often, ns.
    step_ns: i64,
}

/// Random source of a scene, with the values drawn first.
struct SceneDraws {
    random: Random,
    /// Which motion it is, 0 to 1.
    kind: f64,
    /// Direction, rad.
    angle: f64,
    /// Sense, -1 or 1.
    sign: f64,
    /// Of the array, pixels.
    width: f64,
    height: f64,
}

impl SceneDraws {
    fn new(seed: u64, index: u64, extent: Extent) -> SceneDraws {
        let mut random = Random::new(seed, &[index, 77]);
        let mut between = |low: f64, high: f64| low + (high - low) * random.uniform();
        let kind = between(0.0, 1.0);
        let angle = between(0.0, TAU);
        let sign = if between(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
        let (width, height) = (f64::from(extent.width), f64::from(extent.height));
        SceneDraws { random, kind, angle, sign, width, height }
    }

    fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.random.uniform()
    }

    /// The vector (x, y) of a length and an angle.
    fn vector_of_length(length: f64, angle: f64) -> (f64, f64) {
        (length * libm::cos(angle), length * libm::sin(angle))
    }

    /// A place near the middle.
    fn centre(&mut self) -> (f64, f64) {
        (0.5 * self.width + self.uniform(-5.0, 5.0), 0.5 * self.height + self.uniform(-5.0, 5.0))
    }

    /// The moving objects; `ends` as in [`SimulatedScene::draw_scene`], for `end_ns`.
    fn motion(&mut self, ends: [f64; 7], end_ns: i64) -> SketchMotion {
        match ends.iter().position(|end| self.kind < *end) {
            Some(0) => self.texture(),
            Some(1) => self.star(),
            Some(2) => self.photograph(),
            Some(3) => self.layers(),
            Some(4) => self.fan(),
            Some(5) => self.walking_figure(),
            Some(6) => self.ball(end_ns),
            _ => self.discs(),
        }
    }

    /// A texture that drifts and shakes.
    fn texture(&mut self) -> SketchMotion {
        SketchMotion::Texture {
            velocity: SceneDraws::vector_of_length(self.uniform(400.0, 1200.0), self.angle),
            shake_px: self.uniform(0.5, 3.0),
            shake_hz: self.uniform(5.0, 15.0),
        }
    }

    /// A star that turns.
    fn star(&mut self) -> SketchMotion {
        let rate = self.sign * self.uniform(1.5, 5.5) * TAU;
        let centre = self.centre();
        SketchMotion::Star { spokes: self.uniform(3.0, 6.0).floor(), rate, centre }
    }

    /// A photograph that shakes, zooms and turns.
    fn photograph(&mut self) -> SketchMotion {
        let SceneDraws { angle, sign, width, height, .. } = *self;
        let (share, hz) = (self.uniform(0.0, 1.0), self.uniform(3.0, 12.0));
        let speed = self.uniform(100.0, 700.0);
        SketchMotion::Photograph {
            middle: (0.5 * width, 0.5 * height),
            shake: (self.uniform(1.0, 8.0), hz),
            turn: (sign * self.uniform(0.02, 0.2), self.uniform(2.0, 8.0)),
            zoom: (self.uniform(0.02, 0.12), self.uniform(2.0, 6.0)),
            drift: SceneDraws::vector_of_length(share * speed, angle),
        }
    }

    /// Shapes before a texture.
    fn layers(&mut self) -> SketchMotion {
        let SceneDraws { angle, .. } = *self;
        let (front, back, turn) =
            (self.uniform(300.0, 1200.0), self.uniform(50.0, 500.0), self.uniform(0.5, 5.0));
        SketchMotion::Layers {
            size: self.uniform(12.0, 24.0),
            front: SceneDraws::vector_of_length(front, angle),
            back: SceneDraws::vector_of_length(back, angle + turn),
        }
    }

    /// A fan.
    fn fan(&mut self) -> SketchMotion {
        let SceneDraws { angle, sign, height, .. } = *self;
        let centre = self.centre();
        let (blades, rate, radius) = (
            self.uniform(2.0, 6.0).floor(),
            sign * self.uniform(1.0, 9.0) * TAU,
            height * self.uniform(0.35, 0.6),
        );
        SketchMotion::Fan {
            blades,
            rate,
            centre,
            radius,
            half: self.uniform(0.2, 0.45) * TAU / blades / 2.0,
            shade: if angle < 3.0 { 0.0 } else { 0.95 },
        }
    }

    /// A walking figure.
    fn walking_figure(&mut self) -> SketchMotion {
        let SceneDraws { angle, sign, width, height, .. } = *self;
        let tall = height * self.uniform(0.5, 0.9);
        let begin = (width * self.uniform(0.2, 0.8), 0.5 * height + self.uniform(-3.0, 3.0));
        SketchMotion::Figure {
            height: tall,
            speed: sign * self.uniform(60.0, 400.0),
            steps_hz: self.uniform(1.5, 5.0),
            begin,
            shade: if angle < 4.0 { 0.0 } else { 0.95 },
        }
    }

    /// A thrown ball.
    fn ball(&mut self, end_ns: i64) -> SketchMotion {
        let SceneDraws { sign, width, height, .. } = *self;
        let (radius, speed) = (height * self.uniform(0.12, 0.25), self.uniform(200.0, 900.0));
        let begin = (0.5 * width - 0.3 * sign * width, height * self.uniform(0.35, 0.7));
        SketchMotion::Ball {
            radius,
            begin,
            velocity: (sign * speed, -self.uniform(0.0, 300.0)),
            fall: self.uniform(500.0, 4000.0),
            flight_ns: end_ns as f64,
            rate: sign * self.uniform(0.0, 25.0),
        }
    }

    /// Discs that fly over a texture.
    fn discs(&mut self) -> SketchMotion {
        let SceneDraws { angle, sign, .. } = *self;
        let (speed, drift) = (self.uniform(700.0, 2300.0), self.uniform(80.0, 180.0));
        let shade = if sign > 0.0 { 1.1 } else { -0.05 };
        SketchMotion::Discs {
            radius: self.uniform(2.5, 5.5),
            shade,
            velocity: SceneDraws::vector_of_length(speed, angle),
            pitch: self.uniform(60.0, 110.0),
            drift: (drift * libm::sin(angle), drift * libm::cos(angle)),
        }
    }

    /// A random sensor description and the length of its exposures, ns. `which`, 0 to 1, selects its kind.
    fn sensor(&mut self, which: f64) -> (Sensor, i64) {
        let us = |us: f64| Some(Duration::new((us * 1e3).round() as i64));
        let mut sensor = Sensor::unknown("made up");
        let threshold = self.uniform(0.15, 0.25);
        sensor.comparator.threshold_on = Some(threshold);
        sensor.comparator.threshold_off = Some(threshold * self.uniform(0.92, 1.09));
        sensor.comparator.reset = if which < 0.4 { Reset::Resample } else { Reset::Advance };
        sensor.readout.refractory = us(if which < 0.4 { self.uniform(30.0, 90.0).round() } else { 0.0 });
        sensor.readout.latency_min = us(1.0);
        let tau_0 = self.uniform(8.0, 48.0);
        sensor.front_end.tau_0 = us(if which < 0.2 { 0.0 } else { tau_0 });
        sensor.front_end.alpha = us(self.uniform(7_500.0, 31_000.0));
        let exposure_ns = (self.uniform(3.0e6, 4.5e6)).round() as i64;
        sensor.frames.gain =
            Some(self.uniform(600.0, 1200.0) * if self.uniform(0.0, 1.0) < 0.5 { 0.8 } else { 1.0 });
        sensor.frames.row_time = us(self.uniform(25.0, 45.0));
        sensor.frames.saturation_dn = Some(1023.0);
        (sensor, exposure_ns)
    }
}

/// The sharpest edges, pixels on either side.
const SHARPEST: f64 = 0.35;

impl SimulatedScene {
    /// Scene number `index` of a seed, on an array of an extent, for some seconds: a texture, a star or
    /// discs.
    pub fn new(seed: u64, index: u64, extent: Extent, duration_s: f64) -> SimulatedScene {
        SimulatedScene::draw_scene(seed, index, extent, duration_s, [0.5, 0.85, 0.85, 0.85, 0.85, 0.85, 0.85])
    }

    /// A scene that does not move as one: layers, a fan, a figure, a ball.
    pub fn in_parts(seed: u64, index: u64, extent: Extent, duration_s: f64) -> SimulatedScene {
        SimulatedScene::draw_scene(seed, index, extent, duration_s, [0.0, 0.0, 0.0, 0.3, 0.6, 0.8, 1.0])
    }

    /// A scene of any kind.
    pub fn of_any_kind(seed: u64, index: u64, extent: Extent, duration_s: f64) -> SimulatedScene {
        SimulatedScene::draw_scene(seed, index, extent, duration_s, [0.2, 0.3, 0.5, 0.7, 0.8, 0.9, 1.0])
    }

    #[cfg(test)]
    /// The same of a photograph that shakes, zooms and turns.
    pub fn photograph(seed: u64, index: u64, extent: Extent, duration_s: f64) -> SimulatedScene {
        SimulatedScene::draw_scene(seed, index, extent, duration_s, [0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    }

    /// `ends`: upper limits of a uniform draw, 0 to 1, for a texture, a star, a photograph, layers, a fan, a
    /// figure, a ball; above them discs.
    fn draw_scene(seed: u64, index: u64, extent: Extent, duration_s: f64, ends: [f64; 7]) -> SimulatedScene {
        let mut draws = SceneDraws::new(seed, index, extent);
        let span = (0, (duration_s * 1e9) as i64);
        let motion = draws.motion(ends, span.1);
        let (low, high) = (draws.uniform(26.0, 38.0), draws.uniform(150.0, 205.0));
        let which = draws.uniform(0.0, 1.0);
        let (sensor, exposure_ns) = draws.sensor(which);
        let first_ns = draws.uniform(1e5, 6e5).round() as i64;
        let period_ns = 8_333_333;
        let rows_ns = sensor.frames.row_time.map_or(0, Duration::ns) * i64::from(extent.height);
        let exposures = (0..)
            .map(|l| Exposure::new(first_ns + l * period_ns, first_ns + l * period_ns + exposure_ns))
            .take_while(|exposure| exposure.end.0 + rows_ns < span.1)
            .collect();
        let resolution_ns = if which < 0.2 || (0.4..0.7).contains(&which) {
            1_000
        } else if which < 0.4 {
            1
        } else {
            20_000
        };
        let contrast = draws.uniform(0.8, 1.6);
        // Pixels are not points and lenses are not perfect: no edge is sharper than about a third of a pixel
        // on either side.
        let edge = f64::max(draws.uniform(0.1, 0.9), SHARPEST);
        let seed = seed.wrapping_mul(1009).wrapping_add(index);
        SimulatedScene {
            sketch: Sketch { motion, seed, contrast, edge, low, high },
            sensor,
            exposures,
            resolution_ns,
            extent,
            span,
            noise: None,
            unstated_noise: 0.0,
            step_ns: 200_000,
        }
    }

    /// Target number `index` of a seed: a star or discs before a plain wall, thresholds with noise, frames
    /// with stated noise or none.
    pub fn target(seed: u64, index: u64, extent: Extent, duration_s: f64) -> SimulatedScene {
        let mut random = Random::new(seed, &[index, 78]);
        let mut between = |low: f64, high: f64| low + (high - low) * random.uniform();
        let mut made = SimulatedScene::new(seed, index, extent, duration_s);
        if let SketchMotion::Texture { velocity, .. } = made.sketch.motion {
            let rate = between(3.0, 12.0) * TAU * if velocity.0 > 0.0 { 1.0 } else { -1.0 };
            let centre = (
                0.5 * f64::from(extent.width) + between(-2.0, 2.0),
                0.5 * f64::from(extent.height) + between(-2.0, 2.0),
            );
            made.sketch.motion = SketchMotion::Star { spokes: between(2.0, 6.0).floor(), rate, centre };
        }
        // No ground behind discs: a wall.
        made.sketch.contrast = 0.0;
        let noise = between(0.008, 0.035) * made.sensor.comparator.threshold_on.unwrap_or(0.2);
        if between(0.0, 1.0) < 0.75 {
            made.sensor.comparator.threshold_noise = Some(noise);
        } else {
            made.unstated_noise = noise;
        }
        if between(0.0, 1.0) < 0.6 {
            made.sensor.frames.read_noise_dn = Some(between(0.3, 4.0));
            made.sensor.frames.full_well_e = Some(between(9_000.0, 30_000.0));
        }
        made.step_ns = 25_000;
        made
    }

    /// With noise of thresholds that the description states, a share of the ON threshold.
    #[cfg(test)]
    pub fn with_threshold_noise(mut self, share: f64) -> SimulatedScene {
        let comparator = &mut self.sensor.comparator;
        comparator.threshold_noise = comparator.threshold_on.map(|on| share * on);
        self
    }

    /// With edges of a width, pixels on either side.
    #[cfg(test)]
    pub fn with_edge(self, edge: f64) -> SimulatedScene {
        SimulatedScene { sketch: Sketch { edge, ..self.sketch }, ..self }
    }

    /// With frames rounded to whole DN and unstated noise: shot noise of this many electrons per DN, and read
    /// noise, DN.
    #[must_use]
    pub fn with_frame_noise(self, noise: Option<(f64, f64)>) -> SimulatedScene {
        SimulatedScene { noise, ..self }
    }

    /// Log photocurrent of every pixel at instants.
    fn log_tracks(&self) -> Vec<(Vec<i64>, Vec<f64>)> {
        let step_ns = self.step_ns;
        let instants: Vec<i64> = (0..=self.span.1 / step_ns).map(|k| k * step_ns).collect();
        let width = self.extent.width as usize;
        let of = |pixel: usize| {
            let (x, y) = ((pixel % width) as f64, (pixel / width) as f64);
            (
                instants.clone(),
                instants.iter().map(|t| self.sketch.log_light(x, y, *t as f64 * 1e-9)).collect(),
            )
        };
        (0..self.extent.pixels()).into_par_iter().map(of).collect()
    }

    /// The light of every pixel: instants, ns, and photocurrent.
    pub fn light(&self) -> Vec<(Vec<i64>, Vec<f64>)> {
        self.log_tracks()
            .into_iter()
            .map(|(t, log)| (t, log.iter().map(|u| libm::exp(*u)).collect()))
            .collect()
    }

    /// The recording of this scene by this sensor, with nothing beyond the description.
    ///
    /// # Errors
    /// Never for the sensors made here; the message of [`Case::nominal`] or [`record`] otherwise.
    pub fn recording(&self) -> Result<Case, String> {
        self.recording_through(None)
    }

    /// The recording of this scene by a sensor that differs from the description.
    ///
    /// # Errors
    /// When the effects of `trial` cannot be combined.
    pub fn recording_through(&self, trial: Option<&Trial>) -> Result<Case, String> {
        let frames =
            FrameTimes::new(self.exposures.clone(), self.sensor.frames.row_time.map_or(0, Duration::ns))
                .map_err(|why| why.to_string())?;
        let dn = vec![f32::NAN; frames.len() * self.extent.pixels()];
        let blank = Case {
            extent: self.extent,
            span: self.span,
            events: PixelEvents::new(vec![Vec::new(); self.extent.pixels()]),
            has_t_in: true,
            t_resolution_ns: self.resolution_ns,
            frames: Some(CaseFrames::new(frames, dn)),
            sensor: self.sensor.clone(),
        };
        let pixels = self.log_tracks().into_iter().map(|(t, log)| (t, log, true));
        let nominal = blank.nominal().map_err(|why| why.to_string())?;
        let stated = Trial::nominal(&nominal);
        let mut trial = trial.unwrap_or(&stated).clone();
        trial.nominal.threshold_noise = f64::max(trial.nominal.threshold_noise, self.unstated_noise);
        let mut recorded = record(
            &blank,
            &trial.nominal,
            &PixelSample::every_pixel(&blank, 6),
            &LogLightCurves::from_pixels(pixels),
            &trial.effects,
            &SimulatedConditions { seed: self.sketch.seed, ..SimulatedConditions::default() },
        )?;
        if let (Some((electrons, read_dn)), Some(frames)) = (self.noise, &mut recorded.frames) {
            let mut random = Random::new(self.sketch.seed, &[0x7e]);
            *frames = frames.map(|_, dn| {
                let signal = f64::max(f64::from(dn) - nominal.number.black_level, 0.0);
                let noisy =
                    f64::from(dn) + libm::sqrt(signal / electrons + read_dn * read_dn) * random.normal();
                noisy.round().clamp(0.0, nominal.saturation_dn) as f32
            });
        }
        Ok(recorded)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_number_gives_the_same_recording_and_another_number_another() {
        let extent = Extent { width: 18, height: 12 };
        let of = |index: u64| SimulatedScene::new(5, index, extent, 0.05).recording().unwrap();
        let (a, b, c) = (of(1), of(1), of(2));
        assert_eq!(a.events, b.events);
        assert_ne!(a.events, c.events);
        assert!(a.events.len() > 200 && c.frame_count() >= 4);
    }
}

//! What every source of light has in common: its sockets, the light of white, true frames, and the walk over
//! rows.
//!
//! A source ends in photocurrent: reflectance times illuminance times the sensor's photocurrent per lux. True
//! frames show the picture itself at instants, scaled as a frame of a stated exposure would read. What is
//! known in closed form ([`ClosedScene`]) is sampled adaptively ([`super::instants`]); a film that is only
//! known at its frames has its own walk ([`super::video`]).

use super::instants::Sampler;
use photocurrent_core::quantity::{Duration, Illuminance, Rate};
use photocurrent_core::{
    Colour, Context, Exposure, Extent, FrameBlock, FrameScale, FrameSequence, FrameTimes, FramesMeta, Light,
    LightBand, LightMeta, Meta, NodeError, Rows, Sensor, TimeSpan, Truth,
};
use photocurrent_scene::closed::ClosedScene;
use photocurrent_sensor::exposure::DigitalNumber;
use photocurrent_solve::co_located::channel_gains;
use rayon::prelude::*;
use std::sync::Arc;

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// The sensor that looks at the scene: its photocurrent per lux and its gain.
        sensor: Arc<Sensor>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// Photocurrent of every pixel over time.
        light: Light,
        /// The picture at instants, scaled as a frame of the stated exposure.
        truth: Truth,
    }
}

/// What a source gives, before its data.
#[derive(Clone)]
pub struct Metas {
    /// Of the light.
    pub light: LightMeta,
    /// Of the true frames.
    pub truth: FramesMeta,
}

/// Which true frames, and how they read.
#[derive(Clone, Copy, Debug)]
pub struct TruthParams {
    /// True frames per second, at multiples of the period from 0 on.
    pub rate: Rate,
    /// Exposure that they are scaled to.
    pub exposure: Duration,
}

impl Metas {
    /// Of light from 0 to `duration_ns` on `extent` pixels; `instants` is about how many one pixel has, for
    /// memory estimates.
    ///
    /// # Errors
    /// When there would be far too many true frames.
    pub fn new(
        extent: Extent,
        duration_ns: i64,
        instants: f64,
        truth: TruthParams,
    ) -> Result<Metas, NodeError> {
        let count_hint = Some((extent.pixels() as f64 * instants) as u64);
        let light =
            LightMeta { extent, span: TimeSpan::new(0, duration_ns), colour: Colour::Mono, count_hint };
        Ok(Metas { light, truth: truth_meta(extent, duration_ns, truth)? })
    }

    /// The same with colours.
    #[must_use]
    pub fn coloured(mut self, light: Colour, truth: Colour) -> Metas {
        (self.light.colour, self.truth.colour) = (light, truth);
        self
    }

    /// In the order of [`Out`].
    pub fn planned(self) -> Vec<Meta> {
        vec![Meta::Light(Arc::new(self.light)), Meta::Truth(Arc::new(self.truth))]
    }

    /// An empty block for the true frames of some rows; without frames when nobody wants them.
    pub fn truth_block(&self, rows: Rows, cx: &Context) -> FrameBlock {
        let frames = if cx.wants("truth") { self.truth.times.len() } else { 0 };
        FrameBlock::zeros(0..frames, rows, self.truth.row_values())
    }

    /// Rows from top to bottom, as the outputs.
    pub fn out(self, rows: Rows, parts: Vec<(LightBand, FrameBlock)>) -> Out {
        let mut truth = FrameBlock::zeros(0..self.truth.times.len(), rows, self.truth.row_values());
        let mut bands = Vec::with_capacity(parts.len());
        for (band, part) in parts {
            for l in part.frames.clone() {
                for y in part.rows.iter() {
                    truth.row_mut(l, y).copy_from_slice(part.row(l, y));
                }
            }
            bands.push(band);
        }
        let band = if bands.is_empty() {
            LightBand::begin(rows.start, self.light.extent.width * self.light.colour.channels())
        } else {
            joined(bands)
        };
        Out {
            light: Light::in_memory(Arc::new(self.light), band),
            truth: Truth(FrameSequence::in_memory(Arc::new(self.truth), truth)),
        }
    }
}

fn joined(bands: Vec<LightBand>) -> LightBand {
    photocurrent_core::handle::Band::concat(bands)
}

/// More true frames than this do not fit into memory, even without their pixels.
const MOST_TRUE_FRAMES: f64 = 1e7;

/// True frames at multiples of the period from 0 on; each stands for an instant.
fn truth_meta(extent: Extent, duration_ns: i64, truth: TruthParams) -> Result<FramesMeta, NodeError> {
    let (period, asked) = (1e9 / truth.rate.hz(), duration_ns as f64 * 1e-9 * truth.rate.hz());
    if asked > MOST_TRUE_FRAMES {
        return Err(NodeError::usage(format!(
            "`truth_rate` asks for {asked:.0} true frames, and {MOST_TRUE_FRAMES:.0} are the most"
        ))
        .note(format!("{} of light at {}", Duration::new(duration_ns), truth.rate))
        .hint("lower `truth_rate`, or shorten the light")
        .param("truth_rate"));
    }
    let instants = (0..).map(|k| (k as f64 * period).round() as i64).take_while(|t| *t < duration_ns);
    let times = FrameTimes::new(instants.map(|t| Exposure::new(t, t + 1)).collect(), 0)?;
    Ok(FramesMeta {
        extent,
        colour: Colour::Mono,
        times,
        scale: FrameScale::Nominal { exposure_ns: truth.exposure.ns() },
    })
}

/// What a source of light needs to know of the sensor.
pub struct Scale {
    /// Photocurrent of a white pixel.
    pub white: f64,
    number: DigitalNumber,
    channels: [f64; 3],
    exposure_s: f64,
}

impl Scale {
    /// For light of `illuminance` on a sensor, with true frames of `exposure`.
    ///
    /// # Errors
    /// When the description leaves something out; `who` is the asker.
    pub fn new(
        sensor: &Sensor,
        illuminance: Illuminance,
        exposure: Duration,
        who: &str,
    ) -> Result<Scale, NodeError> {
        let stated = [
            ("optics.photocurrent_per_lux", sensor.optics.photocurrent_per_lux.is_some()),
            ("frames.gain", sensor.frames.gain.is_some()),
        ];
        sensor.need_all(&stated, who)?;
        let white = illuminance.lux()
            * sensor.need(sensor.optics.photocurrent_per_lux, "optics.photocurrent_per_lux", who)?;
        let number = DigitalNumber {
            black_level: sensor.frames.black_level_dn.unwrap_or(0.0),
            gain: sensor.need(sensor.frames.gain, "frames.gain", who)?,
        };
        Ok(Scale { white, number, channels: channel_gains(sensor)?, exposure_s: exposure.seconds() })
    }

    /// From photocurrent of a channel to the DN of a true frame.
    fn true_dn_of(&self, channel: Option<usize>, photocurrent: f64) -> f32 {
        let gain = channel.map_or(self.number.gain, |channel| self.number.gain * self.channels[channel]);
        DigitalNumber { gain, ..self.number }.of(photocurrent * self.exposure_s) as f32
    }

    /// From photocurrent to the DN of a true grey frame.
    pub fn true_dn(&self, photocurrent: f64) -> f32 {
        self.number.of(photocurrent * self.exposure_s) as f32
    }
}

/// How closely something that is known at any instant is looked at.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// Longest time between two looks at a pixel that something may cross.
    pub step: Duration,
    /// How far the logarithm of light may be off between instants, natural-log units.
    pub tolerance: f64,
    /// Do things turn back at once? See [`Sampler::graze`].
    pub graze: bool,
}

/// Things move by this between two looks at most, pixels: a pixel's light has few bends in that time.
const LOOK_PX: f64 = 0.25;

/// Pixels that are looked at to estimate how many instants there will be, and for how long each.
const SAMPLED_PIXELS: u64 = 256;
const SAMPLED_NS: i64 = 20_000_000;

impl Look {
    /// The light of a pixel's channel from one instant to another, as a share of white; times are counted
    /// from the first.
    pub fn sample(
        &self,
        scene: &dyn ClosedScene,
        channel: Option<usize>,
        (x, y): (f64, f64),
        start_ns: i64,
        end_ns: i64,
        white: f64,
    ) -> Vec<(i64, f64)> {
        let step = (LOOK_PX / scene.speed(x, y)).min(self.step.ns() as f64);
        let sampler = Sampler {
            end_ns: end_ns - start_ns,
            step_ns: step as i64,
            tolerance: self.tolerance,
            graze: self.graze,
        };
        let still_until = |t: i64| scene.still_until(x, y, start_ns + t).saturating_sub(start_ns);
        sampler.sample(|t| white * reflectance(scene, channel, x, y, start_ns + t), still_until)
    }
}

/// What a scene reflects behind a filter, or in grey.
fn reflectance(scene: &dyn ClosedScene, channel: Option<usize>, x: f64, y: f64, t_ns: i64) -> f64 {
    channel.map_or_else(|| scene.light(x, y, t_ns), |channel| scene.channel(channel, x, y, t_ns))
}

/// About how many instants a pixel will have: some pixels are looked at for a short time each, spread evenly
/// over picture and recording.
pub fn estimated_instants(scene: &dyn ClosedScene, look: Look, extent: Extent, duration_ns: i64) -> f64 {
    let window_ns = duration_ns.min(SAMPLED_NS);
    let bends = |k: u64| {
        // The plastic and the golden number: points that leave no gap in picture and time.
        let place = |irrational: f64, size: f64| ((k as f64 + 0.5) * irrational).fract() * size;
        let (x, y) = (
            place(0.754_877_666_246_693, extent.width.into()).floor(),
            place(0.569_840_290_998_053, extent.height.into()).floor(),
        );
        let start_ns = place(0.618_033_988_749_895, (duration_ns - window_ns) as f64) as i64;
        // Both ends are always there.
        look.sample(scene, None, (x, y), start_ns, start_ns + window_ns, 1.0).len().saturating_sub(2)
    };
    let seen = (0..SAMPLED_PIXELS).map(bends).sum::<usize>() as f64 * duration_ns as f64 / window_ns as f64;
    2.0 + seen / SAMPLED_PIXELS as f64
}

/// Pixels of a row that one thread looks at, at least.
const LEAST_PIXELS: usize = 32;

/// Light and true frames of `scene` on the rows of the context.
///
/// # Errors
/// When the user interrupts.
pub fn look(
    scene: &dyn ClosedScene,
    look: Look,
    scale: &Scale,
    metas: Metas,
    cx: &Context,
) -> Result<Out, NodeError> {
    let (rows, width) = (cx.rows(), metas.light.extent.width);
    cx.begin(rows.len() as u64, "rows");
    let row = |y: u32| -> Result<(LightBand, FrameBlock), NodeError> {
        let (colour, channels) = (metas.light.colour, metas.light.colour.channels());
        let mut light = LightBand::begin(y, width * channels);
        let mut truth = metas.truth_block(Rows { start: y, end: y + 1 }, cx);
        let sample = |value: u32| {
            let place = (f64::from(value / channels), f64::from(y));
            look.sample(scene, colour.channel(value, y), place, 0, metas.light.span.end.0, scale.white)
        };
        // A band may be a single row, so its pixels are shared out as well.
        let sampled: Vec<Vec<(i64, f64)>> =
            (0..width * channels).into_par_iter().with_min_len(LEAST_PIXELS).map(sample).collect();
        for kept in sampled {
            light.push(kept.into_iter().map(|(t, photocurrent)| (t, photocurrent as f32)));
        }
        truth
            .dn
            .par_chunks_mut(metas.truth.row_values().max(1))
            .zip(metas.truth.times.exposures.par_iter())
            .for_each(|(picture, exposure)| {
                for (value, dn) in picture.iter_mut().enumerate() {
                    let (channel, x) =
                        (metas.truth.colour.channel(value as u32, y), value as u32 / metas.truth.channels());
                    let shown = reflectance(scene, channel, f64::from(x), f64::from(y), exposure.start.0);
                    *dn = scale.true_dn_of(channel, scale.white * shown);
                }
            });
        cx.advance(1)?;
        Ok((light, truth))
    };
    let parts: Result<Vec<(LightBand, FrameBlock)>, NodeError> =
        rows.iter().into_par_iter().map(row).collect();
    Ok(metas.out(rows, parts?))
}

//! `align/light`: the light of a scene on the pixels of an event array.
//!
//! With the light of the frames' pixels and the places of an alignment, a simulated pair of cameras is two
//! sensors. One records events of this light, the other frames of the scene's own.
//!
//! Limits: no light behind a mosaic; an event pixel has an instant wherever one of the pixels that it covers
//! has one.

use crate::simulate::pooled::push_mixed;
use photocurrent_core::handle::Band;
use photocurrent_core::light::{Light, LightBand, LightMeta};
use photocurrent_core::series::Series;
use photocurrent_core::{
    Colour, Context, Decl, Extent, Grain, MapSet, Meta, Node, NodeError, PortMetas, Sensor,
};
use photocurrent_scene::alignment::Alignment;
use photocurrent_sensor::pooling::block_weights;
use photocurrent_solve::co_located::event_weights;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Parameters of `align/light`: none.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Light of the pixels of the frames: grey, or red, green and blue.
        light: Light,
        /// Places of the event pixels on the frames: of `read/alignment`.
        alignment: MapSet,
        /// The sensor of the events: how strongly it receives each colour (`optics.event_weights`); absent =
        /// alike.
        sensor: Option<Arc<Sensor>>,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// Light of the event array's pixels, grey.
        light: Light,
    }
}

/// The node.
pub struct AlignLight;

fn plan_of(light: &LightMeta, array: Extent) -> Result<LightMeta, NodeError> {
    if light.colour.is_mosaic() {
        return Err(NodeError::usage(format!("the light is {}", light.colour))
            .hint("connect light without a mosaic: that of a scene in grey or in three channels"));
    }
    Ok(LightMeta { extent: array, colour: Colour::Mono, count_hint: None, ..light.clone() })
}

impl Node for AlignLight {
    const DECL: Decl = Decl {
        kind: "align/light",
        about: "Light of a scene on the pixels of an event array: for the events of a simulated pair of \
                cameras.",
        revision: 1,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["Tulyakov et al., Time Lens, CVPR 2021: two cameras behind a beam splitter"],
        example: r#"
[nodes.places]
kind   = "read/alignment"
params = { homography = [[1.16, -0.02, 0.3], [0.02, 1.16, 0.5], [0.0, 0.0, 1.0]], width = 80, height = 60 }

[nodes.seen]
kind = "align/light"
in   = { light = "scene.light", alignment = "places", sensor = "sensor" }

[nodes.array]
kind = "simulate/sensor"
in   = { light = "seen.light", sensor = "sensor" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(_: Params) -> Result<Self, NodeError> {
        Ok(AlignLight)
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let map = inputs.map("alignment")?;
        Alignment::check(map)?;
        Ok(vec![Meta::Light(Arc::new(plan_of(inputs.light("light")?, map.extent)?))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let alignment = Alignment::from_map(&input.alignment)?;
        let own = &input.light.meta;
        let meta = plan_of(own, alignment.events)?;
        let band = input.light.read(own.extent.rows())?;
        let (cell, channels) = (alignment.pixel_parts(), own.colour.channels());
        let received = input.sensor.as_deref().map(event_weights).transpose()?.flatten();
        let colours = block_weights(own.colour, 1, (0, 0), received);
        cx.begin(u64::from(meta.extent.height), "rows");
        let row = |y: u32| -> Result<LightBand, NodeError> {
            let mut out = LightBand::begin(y, meta.extent.width);
            let mut instants: Vec<i64> = Vec::new();
            for x in 0..meta.extent.width {
                let mut shares: BTreeMap<usize, f64> = BTreeMap::new();
                let pixel = (y * meta.extent.width + x) as usize;
                alignment.covered(&cell, pixel, own.extent, |pixel, share| {
                    *shares.entry(pixel).or_default() += share;
                });
                let mut parts: Vec<(f64, Series<'_>)> = Vec::new();
                for (pixel, share) in shares {
                    let (column, row) = (pixel as u32 % own.extent.width, pixel as u32 / own.extent.width);
                    let values = (column * channels..).zip(&colours).filter(|(_, weight)| **weight > 0.0);
                    parts.extend(values.map(|(value, weight)| (share * weight, band.pixel(value, row))));
                }
                push_mixed(&mut out, &mut instants, &parts);
            }
            cx.advance(1)?;
            Ok(out)
        };
        let bands: Vec<LightBand> =
            (0..meta.extent.height).into_par_iter().map(row).collect::<Result<_, NodeError>>()?;
        Ok(Out { light: Light::in_memory(Arc::new(meta), LightBand::concat(bands)) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::testing::{alignment, shifted};
    use photocurrent_core::light::at;
    use photocurrent_core::{TimeSpan, testing};

    const EXTENT: Extent = Extent { width: 6, height: 5 };

    /// Each value turns at an instant of its own.
    fn light(colour: Colour) -> Light {
        let values = EXTENT.width * colour.channels();
        let mut band = LightBand::begin(0, values);
        for place in 0..values * EXTENT.height {
            let (v, y) = (place % values, place / values);
            let turn = 1_000 + 100 * i64::from(v) + 10 * i64::from(y);
            band.push([(0, 1.0 + v as f32), (turn, 5.0 + (v * y) as f32), (10_000, 2.0 + y as f32)]);
        }
        let meta = LightMeta { extent: EXTENT, span: TimeSpan::new(0, 10_000), colour, count_hint: None };
        Light::in_memory(Arc::new(meta), band)
    }

    fn aligned_light(light: Light, by: f64) -> Light {
        aligned_light_of(light, by, None)
    }

    fn aligned_light_of(light: Light, by: f64, weights: Option<[f64; 3]>) -> Light {
        let mut sensor = Sensor::unknown("events");
        sensor.optics.event_weights = weights;
        let alignment = alignment(EXTENT, &shifted(by));
        let input = In { light, alignment, sensor: Some(Arc::new(sensor)) };
        testing::with_context(EXTENT.rows(), &["light"], |cx| AlignLight.run(input, cx)).0.unwrap().light
    }

    #[test]
    fn a_pixel_between_others_sees_their_mean_at_every_instant() {
        let own = light(Colour::Mono);
        let band = own.read(EXTENT.rows()).unwrap();
        let found = aligned_light(own, 0.5).read(EXTENT.rows()).unwrap();
        for t in [0, 1_234, 1_777, 5_000, 10_000] {
            let of = |x: u32, y: u32| at(band.pixel(x, y), t).unwrap();
            let mean = 0.25 * (of(2, 1) + of(3, 1) + of(2, 2) + of(3, 2));
            let seen = at(found.pixel(2, 1), t).unwrap();
            assert!((seen / mean - 1.0).abs() < 1e-6, "{t}: {seen} {mean}");
        }
    }

    #[test]
    fn pixels_that_lie_on_pixels_see_these_and_colours_are_mixed() {
        let own = light(Colour::Mono);
        let same = aligned_light(own.clone(), 0.0);
        assert_eq!(same.read(EXTENT.rows()).unwrap(), own.read(EXTENT.rows()).unwrap());
        let colours = light(Colour::Rgb);
        let band = colours.read(EXTENT.rows()).unwrap();
        for weights in [[1.0 / 3.0; 3], [0.2, 0.5, 0.3]] {
            let mixed = aligned_light_of(colours.clone(), 0.0, Some(weights)).read(EXTENT.rows()).unwrap();
            let of = |c: u32| weights[c as usize] * at(band.pixel(3 * 4 + c, 2), 3_000).unwrap();
            let expected = (0..3).map(of).sum::<f64>();
            // Light is f32.
            assert!((at(mixed.pixel(4, 2), 3_000).unwrap() / expected - 1.0).abs() < 1e-6);
        }
    }
}

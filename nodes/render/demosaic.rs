//! `render/demosaic`: red, green and blue of every pixel from frames behind a mosaic of filters.
//!
//! `gradients` is the linear filter of Malvar, He and Cutler: bilinear interpolation, corrected by the
//! Laplacian of the colour that was measured at the pixel, for edges lie at the same places in all colours.
//! Beyond the border the picture is mirrored at its outermost pixels, which keeps the mosaic's order.
//! `bilinear` is the mean of the neighbours of the wanted colour, weighted by a tent as wide as the cell (a
//! normalised convolution); for a Bayer mosaic that is bilinear interpolation, and it also does for
//! quad-Bayer ones. What was measured stays as it is in both.
//!
//! Limits: linear DN in, linear DN out: no white balance and no colour matrix, and `gradients` assumes
//! channels of like brightness. A value that is not known (NaN) makes its neighbours unknown with
//! `gradients`, and is left out with `bilinear`.

use crate::reconstruct::by_rows;
use photocurrent_core::{
    Colour, Context, Decl, FrameBlock, FrameSequence, FramesMeta, Grain, Meta, Node, NodeError, PortMetas,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// How missing colours are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Malvar, He and Cutler: 5 x 5 linear filters; Bayer mosaics only.
    Gradients,
    /// The weighted mean of neighbours of that colour.
    Bilinear,
}

/// Parameters of `render/demosaic`.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// How missing colours are found; absent = `gradients` for a Bayer mosaic, `bilinear` for a quad-Bayer
    /// one.
    pub method: Option<Method>,
}

photocurrent_core::ports! {
    /// Inputs.
    pub struct In {
        /// Frames behind a mosaic: captured, rendered, or of a baseline.
        frames: FrameSequence,
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// The same with red, green and blue in every pixel.
        frames: FrameSequence,
    }
}

/// The node.
pub struct RenderDemosaic {
    params: Params,
}

/// Rows above and below that a filter reaches.
const HALO: u32 = 3;

/// The smallest side that can be mirrored.
const LEAST_SIDE: u32 = 4;

impl RenderDemosaic {
    fn plan_of(&self, frames: &FramesMeta) -> Result<(Method, FramesMeta), NodeError> {
        if !frames.colour.is_mosaic() {
            return Err(NodeError::usage(format!(
                "the frames are {}, and only a mosaic has colours to find",
                frames.colour
            ))
            .hint("leave render/demosaic out"));
        }
        if frames.extent.width < LEAST_SIDE || frames.extent.height < LEAST_SIDE {
            return Err(NodeError::usage(format!(
                "frames of {} are too small: a filter needs {LEAST_SIDE} x {LEAST_SIDE} pixels or more",
                frames.extent
            )));
        }
        let method = match (self.params.method, frames.colour) {
            (Some(Method::Gradients), Colour::QuadBayer(_)) => {
                return Err(NodeError::usage(format!(
                    "`method = \"gradients\"` takes Bayer mosaics, and the frames are {}",
                    frames.colour
                ))
                .hint("set `method = \"bilinear\"`")
                .param("method"));
            }
            (Some(method), _) => method,
            (None, Colour::Bayer(_)) => Method::Gradients,
            (None, _) => Method::Bilinear,
        };
        Ok((method, FramesMeta { colour: Colour::Rgb, ..frames.clone() }))
    }
}

impl Node for RenderDemosaic {
    const DECL: Decl = Decl {
        kind: "render/demosaic",
        about: "Red, green and blue of every pixel from frames behind a mosaic of filters.",
        revision: 1,
        grain: Grain::Row { halo: HALO },
        draws: false,
        exports: false,
        sources: &["Malvar, He and Cutler, High-quality linear interpolation for demosaicing of \
                    Bayer-patterned color images, ICASSP 2004"],
        example: r#"
[nodes.colour]
kind   = "render/demosaic"
in     = { frames = "render" }
params = { method = "gradients" }
"#,
    };
    const LOCAL_IN_TIME: bool = true;
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(RenderDemosaic { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![Meta::Frames(Arc::new(self.plan_of(inputs.frames("frames")?)?.1))])
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let (method, meta) = self.plan_of(&input.frames.meta)?;
        let mosaic = input.frames.meta.colour;
        let block = input.frames.read_rows(cx.rows().with_halo(HALO, meta.extent.rows()))?;
        let frames = by_rows(cx, meta.clone(), |y| {
            let mut picture = Vec::with_capacity(meta.times.len() * meta.row_values());
            for l in 0..meta.times.len() {
                let view = View {
                    block: &block,
                    frame: l,
                    width: meta.extent.width as i64,
                    height: meta.extent.height as i64,
                    mosaic,
                };
                for x in 0..i64::from(meta.extent.width) {
                    picture.extend(match method {
                        Method::Gradients => view.by_gradients(x, y.into()),
                        Method::Bilinear => view.by_neighbours(x, y.into()),
                    });
                }
            }
            Ok(picture)
        })?;
        Ok(Out { frames })
    }
}

/// One frame of the mosaic.
struct View<'a> {
    block: &'a FrameBlock,
    frame: usize,
    width: i64,
    height: i64,
    mosaic: Colour,
}

impl View<'_> {
    fn channel(&self, x: i64, y: i64) -> usize {
        self.mosaic.channel(x as u32, y as u32).unwrap_or(0)
    }

    /// The value at a place, mirrored at the outermost pixels.
    fn at(&self, x: i64, y: i64) -> f64 {
        let mirrored = |at: i64, length: i64| if at < 0 { -at } else { at.min(2 * (length - 1) - at) };
        f64::from(
            self.block.row(self.frame, mirrored(y, self.height) as u32)[mirrored(x, self.width) as usize],
        )
    }

    /// Red, green and blue by Malvar, He and Cutler, Fig. 2; of a Bayer mosaic.
    fn by_gradients(&self, x: i64, y: i64) -> [f32; 3] {
        let own = self.at(x, y);
        // Sums over the neighbours at a distance of one and of two along the row, along the column, and at
        // the corners.
        let (row, column) = (self.at(x - 1, y) + self.at(x + 1, y), self.at(x, y - 1) + self.at(x, y + 1));
        let (far_row, far_column) =
            (self.at(x - 2, y) + self.at(x + 2, y), self.at(x, y - 2) + self.at(x, y + 2));
        let corners =
            self.at(x - 1, y - 1) + self.at(x + 1, y - 1) + self.at(x - 1, y + 1) + self.at(x + 1, y + 1);
        let mut rgb = [own; 3];
        let measured = self.channel(x, y);
        if measured == 1 {
            // The colour next to green in its row, and the one above and below it.
            let next = self.channel(x + 1, y);
            rgb[next] = (5.0 * own + 4.0 * row - far_row - corners + 0.5 * far_column) / 8.0;
            rgb[2 - next] = (5.0 * own + 4.0 * column - far_column - corners + 0.5 * far_row) / 8.0;
        } else {
            rgb[1] = (4.0 * own + 2.0 * (row + column) - far_row - far_column) / 8.0;
            rgb[2 - measured] = (6.0 * own + 2.0 * corners - 1.5 * (far_row + far_column)) / 8.0;
        }
        rgb.map(|value| value as f32)
    }

    /// Red, green and blue by the mean of neighbours under a tent.
    fn by_neighbours(&self, x: i64, y: i64) -> [f32; 3] {
        let cell = i64::from(self.mosaic.cell());
        let (mut sums, mut weights) = ([0.0; 3], [0.0; 3]);
        for row in (y - cell + 1).max(0)..(y + cell).min(self.height) {
            for column in (x - cell + 1).max(0)..(x + cell).min(self.width) {
                let (value, weight) =
                    (self.at(column, row), (cell - (column - x).abs()) * (cell - (row - y).abs()));
                if value.is_finite() {
                    let channel = self.channel(column, row);
                    sums[channel] += weight as f64 * value;
                    weights[channel] += weight as f64;
                }
            }
        }
        let mut rgb = [0, 1, 2].map(|channel| (sums[channel] / weights[channel]) as f32);
        rgb[self.channel(x, y)] = self.at(x, y) as f32;
        rgb
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Exposure, Extent, testing};

    const EXTENT: Extent = Extent { width: 16, height: 12 };

    fn mosaic(name: &str, dn: impl Fn(usize, u32, u32) -> f32) -> FrameSequence {
        let colour = Colour::named(name).unwrap();
        let grey = testing::captured(EXTENT, vec![Exposure::new(0, 10)], 0, |_, x, y| {
            dn(colour.channel(x, y).unwrap(), x, y)
        });
        let meta = FramesMeta { colour, ..(*grey.meta).clone() };
        FrameSequence::in_memory(Arc::new(meta), grey.read_rows(grey.rows()).unwrap())
    }

    fn run(method: Option<Method>, frames: &FrameSequence) -> FrameBlock {
        let node = RenderDemosaic { params: Params { method } };
        let (out, _) = testing::with_context(EXTENT.rows(), &["frames"], |cx| {
            node.run(In { frames: frames.clone() }, cx)
        });
        let out = out.unwrap().frames;
        assert_eq!(out.meta.colour, Colour::Rgb);
        out.read_rows(EXTENT.rows()).unwrap()
    }

    /// The filters as they are printed (times 8), for the rows and columns from -2 to 2.
    const GREEN_AT_RED: [[f64; 5]; 5] = [
        [0.0, 0.0, -1.0, 0.0, 0.0],
        [0.0, 0.0, 2.0, 0.0, 0.0],
        [-1.0, 2.0, 4.0, 2.0, -1.0],
        [0.0, 0.0, 2.0, 0.0, 0.0],
        [0.0, 0.0, -1.0, 0.0, 0.0],
    ];
    const RED_AT_GREEN_IN_RED_ROW: [[f64; 5]; 5] = [
        [0.0, 0.0, 0.5, 0.0, 0.0],
        [0.0, -1.0, 0.0, -1.0, 0.0],
        [-1.0, 4.0, 5.0, 4.0, -1.0],
        [0.0, -1.0, 0.0, -1.0, 0.0],
        [0.0, 0.0, 0.5, 0.0, 0.0],
    ];
    const RED_AT_BLUE: [[f64; 5]; 5] = [
        [0.0, 0.0, -1.5, 0.0, 0.0],
        [0.0, 2.0, 0.0, 2.0, 0.0],
        [-1.5, 0.0, 6.0, 0.0, -1.5],
        [0.0, 2.0, 0.0, 2.0, 0.0],
        [0.0, 0.0, -1.5, 0.0, 0.0],
    ];

    #[test]
    fn the_filters_are_the_printed_ones() {
        let transposed = |filter: [[f64; 5]; 5]| -> [[f64; 5]; 5] {
            std::array::from_fn(|i| std::array::from_fn(|j| filter[j][i]))
        };
        let noise = |x: u32, y: u32| ((x * 37 + y * 101 + x * y * 11) % 97) as f32;
        let frames = mosaic("bayer_rggb", |_, x, y| noise(x, y));
        let found = run(None, &frames);
        // At (4, 4) red, (5, 4) green next to red, (4, 5) green above and below red, (5, 5) blue.
        let filters = [
            (4, 4, 1, GREEN_AT_RED),
            (4, 4, 2, RED_AT_BLUE),
            (5, 4, 0, RED_AT_GREEN_IN_RED_ROW),
            (5, 4, 2, transposed(RED_AT_GREEN_IN_RED_ROW)),
            (4, 5, 0, transposed(RED_AT_GREEN_IN_RED_ROW)),
            (4, 5, 2, RED_AT_GREEN_IN_RED_ROW),
            (5, 5, 0, RED_AT_BLUE),
            (5, 5, 1, GREEN_AT_RED),
        ];
        for (x, y, channel, filter) in filters {
            let taps = (0..5u32).flat_map(|dy| (0..5u32).map(move |dx| (dx, dy)));
            let sum: f64 = taps
                .map(|(dx, dy)| filter[dy as usize][dx as usize] * f64::from(noise(x + dx - 2, y + dy - 2)))
                .sum();
            assert!(
                (f64::from(found.row(0, y)[(3 * x) as usize + channel]) - sum / 8.0).abs() < 1e-4,
                "({x}, {y}), channel {channel}"
            );
        }
    }

    #[test]
    fn one_colour_is_found_everywhere_and_what_was_measured_stays() {
        let colour = [120.0, 340.0, 56.0];
        for name in Colour::names().filter(|name| Colour::named(name).unwrap().is_mosaic()) {
            let flat = run(Some(Method::Bilinear), &mosaic(name, |channel, _, _| colour[channel]));
            assert!(
                flat.dn.chunks(3).all(|rgb| rgb
                    .iter()
                    .zip(colour)
                    .all(|(found, expected)| (found - expected).abs() < 1e-3)),
                "{name}"
            );
            let frames = mosaic(name, |_, x, y| (x * x + 7 * y) as f32);
            let (found, measured) = (run(None, &frames), frames.read_rows(EXTENT.rows()).unwrap());
            for (x, y) in EXTENT.rows().iter().flat_map(|y| (0..EXTENT.width).map(move |x| (x, y))) {
                let channel = frames.meta.colour.channel(x, y).unwrap();
                assert_eq!(found.row(0, y)[3 * x as usize + channel], measured.row(0, y)[x as usize]);
            }
        }
        // Filters that look at gradients take the step between colours for one: it stays within a grey
        // picture of one brightness only.
        let grey = run(Some(Method::Gradients), &mosaic("bayer_gbrg", |_, _, _| 77.0));
        assert!(grey.dn.iter().all(|dn| *dn == 77.0));
    }

    #[test]
    fn a_slope_is_found_exactly_away_from_the_border() {
        let slope = |x: u32, y: u32| (100 + 3 * x + 5 * y) as f32;
        for (method, name) in [(Method::Gradients, "bayer_grbg"), (Method::Bilinear, "bayer_rggb")] {
            let found = run(Some(method), &mosaic(name, |_, x, y| slope(x, y)));
            for (x, y) in (2..EXTENT.height - 2).flat_map(|y| (2..EXTENT.width - 2).map(move |x| (x, y))) {
                assert_eq!(found.row(0, y)[3 * x as usize..][..3], [slope(x, y); 3], "{name} at ({x}, {y})");
            }
        }
    }

    #[test]
    fn bands_are_rows_of_the_whole() {
        for name in ["bayer_bggr", "quad_bayer_rggb"] {
            let frames = mosaic(name, |_, x, y| ((x * 37 + y * 101) % 97) as f32);
            let (whole, node) = (run(None, &frames), RenderDemosaic { params: Params::default() });
            for rows in EXTENT.rows().bands(5) {
                let input = In { frames: frames.cut(rows.with_halo(HALO, EXTENT.rows())) };
                let band = testing::with_context(rows, &["frames"], |cx| node.run(input, cx))
                    .0
                    .unwrap()
                    .frames
                    .read_rows(rows)
                    .unwrap();
                assert_eq!(band, whole.slice(0..1, rows));
            }
        }
    }

    #[test]
    fn what_is_no_mosaic_or_the_wrong_one_is_refused() {
        let refused = |method, frames: &FrameSequence| {
            RenderDemosaic { params: Params { method } }.plan_of(&frames.meta).unwrap_err().message
        };
        assert_eq!(
            refused(None, &testing::frames(8, 8, 1)),
            "the frames are mono, and only a mosaic has colours to find"
        );
        let quad = mosaic("quad_bayer_rggb", |_, _, _| 1.0);
        assert_eq!(
            refused(Some(Method::Gradients), &quad),
            "`method = \"gradients\"` takes Bayer mosaics, and the frames are quad_bayer_rggb"
        );
    }
}

//! `score/ssim`: structural similarity to true frames, per frame and pooled.
//!
//! The index of Wang et al. 2004 with their window: Gaussian, sigma 1.5 pixels, 11 x 11, weighted moments
//! without the sample correction, `K1 = 0.01`, `K2 = 0.03`. It is what scikit-image calls
//! `structural_similarity(gaussian_weights=True, sigma=1.5, use_sample_covariance=False)`, to the last
//! digits: moments near the border mirror the picture, and the mean leaves out the 5 pixels whose window does
//! not fit.
//!
//! Calculated on linear DN; the two constants are relative to full scale, so `peak_dn` changes the number.
//! Several channels are measured one by one. Limits: like PSNR it is taken over the whole picture unless
//! `region` or `roi` say otherwise, and it is sensitive to noise in flat areas.

use super::card::{Card, MEAN, OWN, linear_dn};
use super::compare::{In, Pairs, Params, Peak, UNKNOWN, known, unknown};
use super::matching::no_mosaic;
use photocurrent_core::{Context, Decl, Extent, Grain, Meta, Node, NodeError, PortMetas, Table};
use std::sync::Arc;

/// Pixels from the window's middle to its border.
const RADIUS: usize = 5;
const SIGMA: f64 = 1.5;
const K1: f64 = 0.01;
const K2: f64 = 0.03;

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// `ssim` per frame (at most 1), and pooled: the mean over frames.
        scores: Arc<Table>,
    }
}

/// The node.
pub struct ScoreSsim {
    params: Params,
}

fn check_size(extent: Extent) -> Result<(), NodeError> {
    let window = 2 * RADIUS as u32 + 1;
    if extent.width >= window && extent.height >= window {
        return Ok(());
    }
    Err(NodeError::usage(format!(
        "the frames have {extent}, and the window of the index is {window} x {window} pixels"
    ))
    .hint("score larger frames"))
}

impl Node for ScoreSsim {
    const DECL: Decl = Decl {
        kind: "score/ssim",
        about: "Structural similarity to true frames, per frame and pooled.",
        revision: 1,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["Wang, Bovik, Sheikh, Simoncelli: Image quality assessment, IEEE Transactions on Image \
                    Processing 13(4), 2004"],
        example: r#"
[nodes.ssim]
kind   = "score/ssim"
in     = { frames = "render", truth = "recording.truth", sensor = "sensor" }
params = { roi = { x = 40, y = 30, width = 64, height = 64 } }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        Ok(ScoreSsim { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let frames = inputs.frames("frames")?;
        no_mosaic(frames, "a window of SSIM")?;
        let planned = self.params.plan(inputs)?;
        check_size(frames.extent)?;
        Ok(planned)
    }

    fn metrics(_: &Params) -> Vec<String> {
        vec!["ssim".into()]
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let truth = &input.truth.0;
        let pairs = Pairs::new(&input.frames, truth, self.params.tolerance)?;
        let (extent, channels) = (truth.meta.extent, truth.meta.channels() as usize);
        check_size(extent)?;
        let peak = Peak::find(self.params.peak_dn, input.sensor.as_deref(), truth, "true")?;
        let mask = interior(self.params.region.mask_in(self.params.roi, truth, peak.dn)?, extent, channels)?;
        let compared = pairs.map(cx, |picture, reference| {
            cx.count(unknown(picture), UNKNOWN);
            let (mut sum, mut count) = (0.0, 0u64);
            for channel in 0..channels {
                let take = |picture: &[f32]| -> Vec<f64> {
                    picture.iter().skip(channel).step_by(channels).map(|value| known(*value)).collect()
                };
                let map = ssim_map(&take(picture), &take(reference), extent, peak.dn);
                for (value, _) in
                    map.iter().zip(mask.iter().skip(channel).step_by(channels)).filter(|(_, counts)| **counts)
                {
                    sum += value;
                    count += 1;
                }
            }
            Ok(sum / count as f64)
        })?;
        let card = Card {
            definition: "ssim.v1",
            channel: linear_dn(&input.frames.meta),
            range: peak.describe(),
            border: format!("{RADIUS} pixels left out"),
            frames: pairs.describe(),
            region: self.params.region.describe_in(self.params.roi),
            weights: None,
            backend: OWN.into(),
            pooled: MEAN.into(),
            more: vec![("window", "Gaussian 11 x 11, sigma 1.5 pixels".into()), ("k", format!("{K1}, {K2}"))],
        };
        Ok(Out { scores: Arc::new(Table::scores(pairs.scores("ssim", "", &compared), card)) })
    }
}

/// Takes pixels out of a mask whose window does not fit into the picture.
fn interior(mut mask: Vec<bool>, extent: Extent, channels: usize) -> Result<Vec<bool>, NodeError> {
    let (width, height) = (extent.width as usize, extent.height as usize);
    let inside = |at: usize, size: usize| (RADIUS..size - RADIUS).contains(&at);
    for (i, counts) in mask.iter_mut().enumerate() {
        let pixel = i / channels;
        *counts &= inside(pixel % width, width) && inside(pixel / width, height);
    }
    if mask.contains(&true) {
        Ok(mask)
    } else {
        Err(NodeError::input(format!(
            "no pixel of the region is {RADIUS} pixels or more from the border, where the window fits"
        ))
        .hint("choose another `roi` or `region`"))
    }
}

/// The index at every pixel, row-major; `picture` and `reference` are planes of `extent`, `range` is full
/// scale.
pub fn ssim_map(picture: &[f64], reference: &[f64], extent: Extent, range: f64) -> Vec<f64> {
    let smooth = |plane: Vec<f64>| smoothed(&plane, extent);
    let product = |a: &[f64], b: &[f64]| smooth(a.iter().zip(b).map(|(a, b)| a * b).collect());
    let (mean_x, mean_y) = (smooth(picture.to_vec()), smooth(reference.to_vec()));
    let (xx, yy, xy) =
        (product(picture, picture), product(reference, reference), product(picture, reference));
    let (c1, c2) = ((K1 * range) * (K1 * range), (K2 * range) * (K2 * range));
    let index = |i: usize| {
        let (mx, my) = (mean_x[i], mean_y[i]);
        let (var_x, var_y, covariance) = (xx[i] - mx * mx, yy[i] - my * my, xy[i] - mx * my);
        (2.0 * mx * my + c1) * (2.0 * covariance + c2) / ((mx * mx + my * my + c1) * (var_x + var_y + c2))
    };
    (0..picture.len()).map(index).collect()
}

/// A plane under the Gaussian window, mirrored at the border (the border's pixel stands twice).
fn smoothed(plane: &[f64], extent: Extent) -> Vec<f64> {
    let mut weights: Vec<f64> = (0..=2 * RADIUS)
        .map(|k| k as f64 - RADIUS as f64)
        .map(|d| libm::exp(-d * d / (2.0 * SIGMA * SIGMA)))
        .collect();
    let sum: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|weight| *weight /= sum);
    let (width, height) = (extent.width as usize, extent.height as usize);
    let mut rows = vec![0.0; plane.len()];
    let mut padded = vec![0.0; width + 2 * RADIUS];
    for (row, out) in plane.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
        (0..padded.len()).for_each(|i| padded[i] = row[mirrored(i, width)]);
        for (x, out) in out.iter_mut().enumerate() {
            *out = weights.iter().zip(&padded[x..]).map(|(weight, value)| weight * value).sum();
        }
    }
    let mut result = vec![0.0; plane.len()];
    for (y, out) in result.chunks_exact_mut(width).enumerate() {
        for (k, weight) in weights.iter().enumerate() {
            let row = mirrored(y + k, height) * width;
            out.iter_mut().zip(&rows[row..row + width]).for_each(|(out, value)| *out += weight * value);
        }
    }
    result
}

/// The index in a line of `size` that stands at place `at` of the line widened by the radius on both sides;
/// `size` is at least the window's.
fn mirrored(at: usize, size: usize) -> usize {
    match at.checked_sub(RADIUS) {
        None => RADIUS - 1 - at,
        Some(i) if i < size => i,
        Some(i) => 2 * size - 1 - i,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crop::Crop;
    use photocurrent_core::{
        Exposure, FrameBlock, FrameScale, FrameSequence, FrameTimes, FramesMeta, Truth, testing,
    };

    const SIZE: Extent = Extent { width: 17, height: 14 };

    // What scikit-image gives; see the test that uses them.
    const MEAN_255: f64 = 0.9427175854759478;
    const MEAN_110: f64 = 0.9421811469900938;
    const MEAN_ROI: f64 = 0.9390860510408798;
    const MEAN_COLOUR: f64 = 0.5935489187309128;
    const AT: [f64; 5] =
        [0.9685444965652491, 0.9461182777922551, 0.939101281348231, 0.9732695109128996, 0.9327139814544612];

    /// Whole numbers, so that another program makes the very same pictures.
    fn reference(x: u32, y: u32) -> f32 {
        ((x * 37 + y * 91 + (x * y) % 13 * 5) % 200) as f32
    }

    fn picture(x: u32, y: u32) -> f32 {
        (4.0 * reference(x, y) / 5.0).floor() + ((x * 53 + y * 29) % 41) as f32
    }

    fn grey(dn: impl Fn(u32, u32) -> f32) -> FrameSequence {
        testing::captured(SIZE, vec![Exposure::new(0, 100)], 0, |_, x, y| dn(x, y))
    }

    fn run(params: Params, frames: FrameSequence, truth: FrameSequence) -> Result<f64, NodeError> {
        let input = In { frames, truth: Truth(truth), sensor: None };
        let (out, _) =
            testing::with_context(SIZE.rows(), &["scores"], |cx| ScoreSsim { params }.run(input, cx));
        let scores = out?.scores.as_scores().unwrap();
        assert_eq!(
            scores[0].value.to_bits(),
            scores[1].value.to_bits(),
            "the mean of one frame is that frame's"
        );
        Ok(scores[0].value)
    }

    fn params(peak_dn: f64) -> Params {
        Params { peak_dn: Some(peak_dn), ..Params::default() }
    }

    /// Values of scikit-image 0.26: `structural_similarity(a, b, gaussian_weights=True, sigma=1.5,
    /// use_sample_covariance=False, data_range=..., full=True)`.
    #[test]
    fn the_index_is_that_of_scikit_image() {
        for (range, expected) in [(255.0, MEAN_255), (110.0, MEAN_110)] {
            let found = run(params(range), grey(picture), grey(reference)).unwrap();
            assert!((found - expected).abs() < 1e-9, "{range}: {found}");
        }
        let plane = |dn: fn(u32, u32) -> f32| -> Vec<f64> {
            (0..14).flat_map(|y| (0..17).map(move |x| f64::from(dn(x, y)))).collect()
        };
        let map = ssim_map(&plane(reference), &plane(picture), SIZE, 255.0);
        for ((x, y), expected) in [(0, 0), (5, 5), (8, 7), (16, 13), (11, 6)].into_iter().zip(AT) {
            assert!((map[y * 17 + x] - expected).abs() < 1e-9, "({x}, {y}): {}", map[y * 17 + x]);
        }
    }

    #[test]
    fn the_mean_over_a_rectangle_is_that_of_the_map() {
        let roi = Some(Crop { x: 7, y: 6, width: 5, height: 2 });
        let found = run(Params { roi, ..params(255.0) }, grey(picture), grey(reference)).unwrap();
        assert!((found - MEAN_ROI).abs() < 1e-9, "{found}");
    }

    #[test]
    fn channels_are_measured_one_by_one() {
        let colour = |dn: &dyn Fn(u32, u32) -> [f32; 3]| {
            let times = FrameTimes::new(vec![Exposure::new(0, 100)], 0).unwrap();
            let meta = FramesMeta {
                extent: SIZE,
                colour: photocurrent_core::Colour::Rgb,
                times,
                scale: FrameScale::Captured,
            };
            let mut block = FrameBlock::zeros(0..1, SIZE.rows(), 51);
            block.dn = (0..14).flat_map(|y| (0..17).flat_map(move |x| dn(x, y))).collect();
            FrameSequence::in_memory(Arc::new(meta), block)
        };
        let truth = colour(&|x, y| [reference(x, y), picture(x, y), reference(x, 13 - y)]);
        let found = run(params(255.0), colour(&|x, y| [picture(x, y); 3]), truth).unwrap();
        assert!((found - MEAN_COLOUR).abs() < 1e-9, "{found}");
    }

    #[test]
    fn equal_frames_have_the_index_one_and_unknown_values_do_not_help() {
        assert_eq!(run(params(255.0), grey(reference), grey(reference)).unwrap(), 1.0);
        let holes = |x, y| if x % 4 == 0 { f32::NAN } else { reference(x, y) };
        assert!(run(params(255.0), grey(holes), grey(reference)).unwrap() < 0.9);
    }

    #[test]
    fn where_no_window_fits_there_is_a_reason_and_no_number() {
        let roi = Some(Crop { x: 0, y: 0, width: 5, height: 14 });
        let error = run(Params { roi, ..params(255.0) }, grey(picture), grey(reference)).unwrap_err();
        assert!(
            error.message.starts_with("no pixel of the region is 5 pixels or more from the border"),
            "{}",
            error.message
        );
        assert!(check_size(Extent { width: 10, height: 40 }).unwrap_err().message.contains("11 x 11"));
        assert!(check_size(Extent { width: 11, height: 11 }).is_ok());
    }
}

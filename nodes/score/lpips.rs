//! `score/lpips`: learned perceptual distance to true frames, per frame and pooled. Zero is best.
//!
//! LPIPS of Zhang et al. 2018: both pictures go through a network, and the weighted difference of its
//! features is the distance. The network is an ONNX file, `weights`; `data/weights/lpips_alex.onnx` of this
//! project is AlexNet, version 0.1, linear layers included. Others differ in numbers: the card has the digest
//! of the file. Any file with the inputs `img0` and `img1` (RGB, [1, 3, h, w], 0 to 1) and the output `lpips`
//! will do.
//!
//! DN above black are divided by the peak and clipped to 0 to 1; grey frames stand in all three channels. The
//! networks were trained on pictures in sRGB: `encoding = "srgb"` applies its curve first, `"linear"` gives
//! DN as they are.
//!
//! Limits: sums of f32 in an order that depends on the processor: numbers agree between machines and backends
//! to about 1e-6, not to the last bit.

use super::card::{Card, MEAN};
use super::compare::{In, Pairs, Peak, UNKNOWN, known, unknown};
use super::matching::{match_frames, no_mosaic};
use crate::crop::Crop;
use crate::onnx::{self, Network, Tensor};
use photocurrent_core::quantity::{Duration, InputPath};
use photocurrent_core::table::TableMeta;
use photocurrent_core::{
    Context, Decl, Digest, Extent, FileRef, FramesMeta, Grain, Meta, Node, NodeError, PortMetas, Table,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Smallest side of a picture that five layers of AlexNet can look at, pixels.
const LEAST_SIZE: u32 = 32;

/// Parameters of `score/lpips`.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The network: an ONNX file, such as `data/weights/lpips_alex.onnx` of this project; relative to the
    /// manifest that names it.
    pub weights: InputPath,
    /// An ONNX Runtime library (version 1.24 or newer) that runs it; absent = the embedded backend.
    pub runtime: Option<InputPath>,
    /// In which encoding the network sees the frames.
    pub encoding: Encoding,
    /// DN that becomes 1, above black; absent = saturation of the connected sensor, else the largest true
    /// value.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub peak_dn: Option<f64>,
    /// Only this rectangle is looked at, 32 x 32 pixels or more; absent = the whole picture.
    pub roi: Option<Crop>,
    /// How far apart the middles of two exposures may lie.
    #[schemars(extend("x-min" = "0 ns"))]
    pub tolerance: Duration,
}

impl Default for Params {
    fn default() -> Self {
        Params {
            weights: InputPath::default(),
            runtime: None,
            encoding: Encoding::Linear,
            peak_dn: None,
            roi: None,
            tolerance: Duration::new(1000),
        }
    }
}

/// In which encoding a network sees frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Encoding {
    /// DN as they are.
    #[default]
    Linear,
    /// Through the curve of sRGB (IEC 61966-2-1).
    Srgb,
}

impl Encoding {
    /// The share of the peak that an encoded value stands for; below 0 counts as 0 on the curve.
    pub(crate) fn undone(self, value: f64) -> f64 {
        match self {
            Encoding::Linear => value,
            Encoding::Srgb if value <= 0.040_45 => f64::max(value, 0.0) / 12.92,
            Encoding::Srgb => libm::pow((value + 0.055) / 1.055, 2.4),
        }
    }

    /// Of a share of the peak, 0 to 1.
    pub(crate) fn of(self, share: f64) -> f64 {
        match self {
            Encoding::Linear => share,
            Encoding::Srgb if share <= 0.003_130_8 => 12.92 * share,
            Encoding::Srgb => 1.055 * libm::pow(share, 1.0 / 2.4) - 0.055,
        }
    }
}

photocurrent_core::ports! {
    /// Outputs.
    pub struct Out {
        /// `lpips` per frame (0 or more, lower is better), and pooled: the mean over frames.
        scores: Arc<Table>,
    }
}

/// The node.
pub struct ScoreLpips {
    params: Params,
}

impl ScoreLpips {
    fn check(&self, frames: &FramesMeta) -> Result<(), NodeError> {
        let roi = self.params.roi.unwrap_or(Crop::whole(frames.extent));
        roi.check("roi", "frames", frames.extent)?;
        if roi.width < LEAST_SIZE || roi.height < LEAST_SIZE {
            return Err(NodeError::usage(format!(
                "{} are too few: the network looks at {LEAST_SIZE} x {LEAST_SIZE} or more",
                roi.describe()
            ))
            .hint("score larger frames, or a larger `roi`"));
        }
        no_mosaic(frames, "the network")
    }

    fn weights(&self) -> Result<Vec<u8>, NodeError> {
        let path = self.params.weights.path();
        std::fs::read(path).map_err(|error| {
            NodeError::files(photocurrent_core::error::cannot_read(path, &error))
                .note(
                    "the network of LPIPS (AlexNet, version 0.1) is data/weights/lpips_alex.onnx of this \
                     project; where it comes from stands in data/README.md",
                )
                .hint("name that file; paths are relative to the manifest that names them")
                .param("weights")
        })
    }
}

impl Node for ScoreLpips {
    const DECL: Decl = Decl {
        kind: "score/lpips",
        about: "Learned perceptual distance (LPIPS) to true frames, per frame and pooled.",
        revision: 1,
        grain: Grain::Whole,
        draws: false,
        exports: false,
        sources: &["Zhang, Isola, Efros, Shechtman, Wang: The Unreasonable Effectiveness of Deep Features \
                    as a Perceptual Metric, CVPR 2018"],
        example: r#"
[nodes.lpips]
kind   = "score/lpips"
in     = { frames = "render", truth = "recording.truth", sensor = "sensor" }
params = { weights = "data/weights/lpips_alex.onnx" }
"#,
    };
    type Params = Params;
    type In = In;
    type Out = Out;

    fn build(params: Params) -> Result<Self, NodeError> {
        onnx::need_weights(&params.weights, "data/weights/lpips_alex.onnx")?;
        Ok(ScoreLpips { params })
    }

    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let frames = inputs.frames("frames")?;
        match_frames(frames, inputs.truth("truth")?, self.params.tolerance.ns())?;
        self.check(frames)?;
        if !self.params.weights.path().is_file() {
            self.weights()?;
        }
        Ok(vec![Meta::Table(Arc::new(TableMeta { scores: true }))])
    }

    fn metrics(_: &Params) -> Vec<String> {
        vec!["lpips".into()]
    }

    fn run(&self, input: In, cx: &Context) -> Result<Out, NodeError> {
        let (frames, truth) = (&input.frames, &input.truth.0);
        let pairs = Pairs::new(frames, truth, self.params.tolerance)?;
        self.check(&frames.meta)?;
        let peak = Peak::find(self.params.peak_dn, input.sensor.as_deref(), truth, "true")?;
        let black = input.sensor.as_deref().and_then(|sensor| sensor.frames.black_level_dn).unwrap_or(0.0);
        let content = self.weights()?;
        let digest = Digest::of_bytes(&content);
        let name = self
            .params
            .weights
            .path()
            .file_name()
            .map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let network = onnx::load(&name, content, self.params.runtime.as_ref().map(InputPath::path)).map_err(
            |error| match error.param {
                Some(_) => error,
                None => error.param("weights"),
            },
        )?;
        let roi = self.params.roi.unwrap_or(Crop::whole(frames.meta.extent));
        let view = View {
            extent: frames.meta.extent,
            channels: frames.meta.channels() as usize,
            roi,
            black,
            peak: peak.dn,
            encoding: self.params.encoding,
        };
        let distances = pairs.map(cx, |picture, reference| {
            cx.count(unknown(picture), UNKNOWN);
            cx.count(view.clipped(picture), "values lay below black or above the peak and were clipped");
            distance(&*network, &view.tensor(picture), &view.tensor(reference))
        })?;
        let encoding = match self.params.encoding {
            Encoding::Linear => "linear DN",
            Encoding::Srgb => "sRGB of DN",
        };
        let card = Card {
            definition: "lpips.v0.1",
            channel: format!(
                "{encoding}, {}",
                if frames.meta.channels() == 1 { "grey in three channels" } else { "RGB" }
            ),
            range: format!("0 to 1 of {}, black level {black} DN subtracted, clipped", peak.describe()),
            border: "none".into(),
            frames: pairs.describe(),
            region: self.params.roi.map_or("all pixels".into(), Crop::describe),
            weights: Some(format!("{digest} ({name})")),
            backend: network.backend(),
            pooled: MEAN.into(),
            more: Vec::new(),
        };
        Ok(Out { scores: Arc::new(Table::scores(pairs.scores("lpips", "", &distances), card)) })
    }

    fn files(&self) -> Vec<FileRef> {
        onnx::files("weights", &self.params.weights, self.params.runtime.as_ref())
    }
}

/// How frames become what the network sees.
struct View {
    extent: Extent,
    channels: usize,
    roi: Crop,
    black: f64,
    peak: f64,
    encoding: Encoding,
}

impl View {
    /// Values of the rectangle that belong to one channel, row by row.
    fn values<'a>(&self, picture: &'a [f32], channel: usize) -> impl Iterator<Item = f32> + 'a {
        let (roi, width, channels) = (self.roi, self.extent.width as usize, self.channels);
        let at = move |x: u32, y: u32| (y as usize * width + x as usize) * channels + channel;
        (roi.y..roi.y + roi.height)
            .flat_map(move |y| (roi.x..roi.x + roi.width).map(move |x| picture[at(x, y)]))
    }

    fn share(&self, value: f32) -> f64 {
        (known(value) - self.black) / self.peak
    }

    fn clipped(&self, picture: &[f32]) -> u64 {
        let outside = |value: &f32| value.is_finite() && !(0.0..=1.0).contains(&self.share(*value));
        (0..self.channels).map(|channel| self.values(picture, channel).filter(outside).count() as u64).sum()
    }

    fn tensor(&self, picture: &[f32]) -> Tensor {
        let of_channel = |channel: usize| {
            self.values(picture, channel % self.channels)
                .map(|value| self.encoding.of(self.share(value).clamp(0.0, 1.0)) as f32)
        };
        Tensor {
            shape: vec![1, 3, self.roi.height as usize, self.roi.width as usize],
            values: (0..3).flat_map(of_channel).collect(),
        }
    }
}

fn distance(network: &dyn Network, picture: &Tensor, reference: &Tensor) -> Result<f64, NodeError> {
    let output = network.run(&[("img0", picture), ("img1", reference)], "lpips")?;
    match output.values[..] {
        [distance] => Ok(f64::from(distance)),
        _ => Err(NodeError::input(format!(
            "the output `lpips` of the network has {} values, and one distance is expected",
            output.values.len()
        ))
        .param("weights")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use photocurrent_core::{Exposure, FrameBlock, FrameScale, FrameSequence, FrameTimes, Truth, testing};
    use std::path::PathBuf;

    fn data(name: &str) -> PathBuf {
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../data/weights").join(name)
    }

    fn params() -> Params {
        Params { weights: InputPath::new(data("lpips_alex.onnx")), peak_dn: Some(255.0), ..Params::default() }
    }

    /// A picture of `data/weights/lpips_synthetic`, its codes as DN.
    fn picture(name: &str) -> FrameSequence {
        let file = std::fs::File::open(data("lpips_synthetic").join(name)).unwrap();
        let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        assert_eq!((info.color_type, info.bit_depth), (png::ColorType::Rgb, png::BitDepth::Eight));
        let extent = Extent { width: info.width, height: info.height };
        let times = FrameTimes::new(vec![Exposure::new(0, 1000)], 0).unwrap();
        let meta =
            FramesMeta { extent, colour: photocurrent_core::Colour::Rgb, times, scale: FrameScale::Captured };
        let mut block = FrameBlock::zeros(0..1, extent.rows(), meta.row_values());
        block.dn = bytes.iter().map(|code| f32::from(*code)).collect();
        FrameSequence::in_memory(Arc::new(meta), block)
    }

    fn run(
        params: Params,
        frames: FrameSequence,
        truth: FrameSequence,
    ) -> Result<(f64, Arc<Table>, Vec<String>), NodeError> {
        let node = ScoreLpips::build(params)?;
        let rows = frames.rows();
        let (out, notes) = testing::with_context(rows, &["scores"], |cx| {
            node.run(In { frames, truth: Truth(truth), sensor: None }, cx)
        });
        let table = out?.scores;
        Ok((table.as_scores().unwrap()[0].value, table, notes))
    }

    /// The distances in `expected_alex.json` were calculated by the authors' definition in another program.
    #[test]
    fn distances_are_those_of_the_published_network() {
        let expected: serde_json::Value =
            serde_json::from_slice(&std::fs::read(data("lpips_synthetic/expected_alex.json")).unwrap())
                .unwrap();
        for name in ["reference", "blurred", "noisy", "shifted"] {
            let (found, table, notes) =
                run(params(), picture(&format!("{name}.png")), picture("reference.png")).unwrap();
            let expected = expected[name].as_f64().unwrap();
            assert!((found - expected).abs() < 1e-4, "{name}: {found} for {expected}");
            assert_eq!(notes, [""; 0]);
            let card = &table.notes[0].1;
            assert!(
                card.contains("weights = ")
                    && card.contains("(lpips_alex.onnx); backend = embedded (rten 0.27)"),
                "{card}"
            );
        }
    }

    #[test]
    fn a_rectangle_is_looked_at_alone_and_grey_stands_in_all_channels() {
        let grey = |dn: fn(u32, u32) -> f32| {
            testing::captured(
                Extent { width: 64, height: 48 },
                vec![Exposure::new(0, 1000)],
                0,
                move |_, x, y| dn(x, y),
            )
        };
        let pattern = |x: u32, y: u32| ((x * 37 + y * 91) % 200) as f32;
        let spoiled_right = |x: u32, y: u32| if x < 32 { ((x * 37 + y * 91) % 200) as f32 } else { 100.0 };
        let of = |roi| run(Params { roi, ..params() }, grey(spoiled_right), grey(pattern)).unwrap().0;
        assert_eq!(of(Some(Crop { x: 0, y: 4, width: 32, height: 40 })), 0.0);
        assert!(of(None) > 0.05);
    }

    #[test]
    fn values_beyond_the_peak_are_clipped_and_counted() {
        let flat = |dn: f32| {
            testing::captured(
                Extent { width: 32, height: 32 },
                vec![Exposure::new(0, 1000)],
                0,
                move |_, _, _| dn,
            )
        };
        let (found, _, notes) = run(params(), flat(300.0), flat(255.0)).unwrap();
        assert_eq!(
            (found, notes),
            (0.0, vec!["1024 values lay below black or above the peak and were clipped".to_string()])
        );
    }

    #[test]
    fn the_curve_of_srgb_meets_its_table() {
        // IEC 61966-2-1: half of the light is code 188 of 255, 18 % are 118, one per mille is 3.3.
        for (share, code) in [(0.0, 0.0), (0.001, 3.2946), (0.18, 117.6), (0.5, 187.5), (1.0, 255.0)] {
            assert!(
                (255.0 * Encoding::Srgb.of(share) - code).abs() < 0.1,
                "{share}: {}",
                255.0 * Encoding::Srgb.of(share)
            );
            // The standard's two branches meet to a few parts in 100,000.
            assert!((Encoding::Srgb.undone(Encoding::Srgb.of(share)) - share).abs() < 1e-6);
        }
    }

    #[test]
    fn missing_weights_small_pictures_and_other_sizes_give_a_reason() {
        assert_eq!(ScoreLpips::build(Params::default()).err().unwrap().param.as_deref(), Some("weights"));
        let flat = |width: u32| {
            testing::captured(
                Extent { width, height: 40 },
                vec![Exposure::new(0, 1000)],
                0,
                move |_, _, _| 9.0,
            )
        };
        let lost =
            Params { weights: InputPath::new("no/such.onnx"), peak_dn: Some(9.0), ..Params::default() };
        let error = run(lost, flat(40), flat(40)).err().unwrap();
        assert_eq!(error.message, "cannot read no/such.onnx: there is no such file");
        assert!(error.notes[0].contains("data/weights/lpips_alex.onnx"), "{:?}", error.notes);
        assert!(
            run(params(), flat(31), flat(31))
                .err()
                .unwrap()
                .message
                .starts_with("31 x 40 pixels at (0, 0) are too few")
        );
        assert!(
            run(params(), flat(40), flat(41)).err().unwrap().message.contains("the reference is 41 x 40")
        );
    }
}

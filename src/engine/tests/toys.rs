//! Toy nodes: small numbers on small planes, one for every way a node can behave.

use super::film::{ReadFilm, Seen, WriteLast};
use super::troubles::{Heavy, Trouble};
use photocurrent_core::handle::Band;
use photocurrent_core::quantity::{InputPath, Rate};
use photocurrent_core::table::{Score, TableMeta};
use photocurrent_core::{
    Catalogue, Context, DataType, Decl, Extent, FileRef, FrameSequence, Grain, Kind, MapBand, MapMeta,
    MapSet, Meta, Node, NodeError, PortMetas, Table, testing,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

pub fn catalogue() -> Catalogue {
    Catalogue::new(vec![
        Kind::of::<Source>(),
        Kind::of::<Add>(),
        Kind::of::<Scale>(),
        Kind::of::<Smooth>(),
        Kind::of::<Sign>(),
        Kind::of::<Couple>(),
        Kind::of::<Split>(),
        Kind::of::<Noise>(),
        Kind::of::<Sum>(),
        Kind::of::<Trouble>(),
        Kind::of::<Frames>(),
        Kind::of::<Write>(),
        Kind::of::<Heavy>(),
        Kind::of::<Grey>(),
        Kind::of::<ReadFilm>(),
        Kind::of::<Seen>(),
        Kind::of::<WriteLast>(),
    ])
}

pub const fn decl(kind: &'static str, grain: Grain) -> Decl {
    Decl {
        kind,
        about: "A toy.",
        revision: 1,
        grain,
        draws: false,
        exports: false,
        sources: &[],
        example: "",
    }
}

/// The part of a toy that all of them have: its types, how it is built, and the plan of those that give a
/// plane like their own.
macro_rules! head {
    ($name:ident $(($params:ty))?, $in:ty => $out:ty; plans its plane) => {
        head!($name $(($params))?, $in => $out);
        fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
            Ok(vec![super::toys::plane_meta(inputs)])
        }
    };
    ($name:ident, $in:ty => $out:ty) => {
        type Params = super::toys::NoParams;
        type In = $in;
        type Out = $out;
        fn build(_: Self::Params) -> Result<Self, NodeError> {
            Ok($name)
        }
    };
    ($name:ident($params:ty), $in:ty => $out:ty) => {
        type Params = $params;
        type In = $in;
        type Out = $out;
        fn build(params: $params) -> Result<Self, NodeError> {
            Ok($name(params))
        }
    };
}
pub(crate) use head;

photocurrent_core::ports! {
    /// Nothing.
    pub struct Nothing {}
}
photocurrent_core::ports! {
    /// One plane.
    pub struct Plane {
        /// The plane.
        plane: MapSet,
    }
}

pub fn meta(width: u32, height: u32) -> MapMeta {
    MapMeta { extent: Extent { width, height }, planes: vec!["value".into()] }
}

pub fn plane_meta(inputs: &PortMetas) -> Meta {
    inputs.all("plane")[0].clone()
}

/// Each pixel of the rows asked for, from the same pixel of the input.
pub fn map_pixels(input: &MapSet, cx: &Context, f: impl Fn(f32) -> f32) -> Result<MapSet, NodeError> {
    let mut band = input.read(cx.rows())?;
    band.values.iter_mut().for_each(|value| *value = f(*value));
    Ok(MapSet::in_memory(input.meta.clone(), band))
}

/// Where a plane begins.
pub struct Source(SourceParams);

#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SourceParams {
    /// Columns.
    #[schemars(range(min = 1))]
    width: u32,
    /// Rows.
    #[schemars(range(min = 1))]
    height: u32,
    /// Added to every pixel.
    offset: f64,
    /// A file whose length is added.
    path: Option<InputPath>,
}

impl Default for SourceParams {
    fn default() -> Self {
        SourceParams { width: 4, height: 12, offset: 1.0, path: None }
    }
}

impl Node for Source {
    const DECL: Decl = decl("read/source", Grain::Whole);
    head!(Source(SourceParams), Nothing => Plane);
    fn plan(&self, _: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![Meta::Map(Arc::new(meta(self.0.width, self.0.height)))])
    }
    fn run(&self, _: Nothing, cx: &Context) -> Result<Plane, NodeError> {
        let meta = meta(self.0.width, self.0.height);
        let extra =
            self.0.path.as_ref().map_or(Ok(0), |path| std::fs::read(path.path()).map(|bytes| bytes.len()));
        let extra = extra.map_err(|error| NodeError::files(error.to_string()))?;
        let mut band = MapBand::zeros(cx.rows(), &meta);
        for y in cx.rows().iter() {
            for (x, value) in band.row_mut(0, y).iter_mut().enumerate() {
                *value = (self.0.offset + extra as f64) as f32 + x as f32 * 0.25 + y as f32 * 0.5;
            }
        }
        Ok(Plane { plane: MapSet::in_memory(Arc::new(meta), band) })
    }
    fn files(&self) -> Vec<FileRef> {
        self.0
            .path
            .iter()
            .map(|path| FileRef { param: "path".into(), path: path.path().to_path_buf() })
            .collect()
    }
}

#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AddParams {
    /// How much.
    #[schemars(range(min = -100.0, max = 100.0))]
    amount: f64,
    /// With a unit.
    rate: Rate,
    /// Which way.
    direction: Direction,
}

#[derive(Clone, Copy, Default, Serialize, Deserialize, JsonSchema, PartialEq)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    /// More.
    #[default]
    Up,
    /// Less.
    Down,
}

impl Default for AddParams {
    fn default() -> Self {
        AddParams { amount: 1.0, rate: Rate::new(1000.0), direction: Direction::Up }
    }
}

/// Adds a number; refuses 13 while planning, and 14 with a rate while building.
pub struct Add(AddParams);

impl Node for Add {
    const DECL: Decl = decl("solve/add", Grain::Pixel);
    type Params = AddParams;
    type In = Plane;
    type Out = Plane;
    fn build(params: AddParams) -> Result<Self, NodeError> {
        if params.amount == 14.0 {
            return Err(NodeError::usage("`amount` must not be 14").param("amount").hint("take 15"));
        }
        Ok(Add(params))
    }
    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        if self.0.amount == 13.0 {
            return Err(NodeError::usage("`amount` must not be 13 here")
                .param("amount")
                .note("somebody is superstitious")
                .hint("take 15"));
        }
        Ok(vec![plane_meta(inputs)])
    }
    fn run(&self, input: Plane, cx: &Context) -> Result<Plane, NodeError> {
        let sign = if self.0.direction == Direction::Up { 1.0 } else { -1.0 };
        cx.count(cx.rows().len() as u64, "rows were added to");
        Ok(Plane { plane: map_pixels(&input.plane, cx, |value| value + (sign * self.0.amount) as f32)? })
    }
}

#[derive(Serialize, Deserialize, JsonSchema, Default)]
#[serde(default, deny_unknown_fields)]
pub struct ScaleParams {
    /// By how much.
    factor: f64,
}

/// Another method of the same role as [`Add`], with other parameters.
pub struct Scale(ScaleParams);

impl Node for Scale {
    const DECL: Decl = decl("solve/scale", Grain::Pixel);
    head!(Scale(ScaleParams), Plane => Plane; plans its plane);
    fn run(&self, input: Plane, cx: &Context) -> Result<Plane, NodeError> {
        Ok(Plane { plane: map_pixels(&input.plane, cx, |value| value * self.0.factor as f32)? })
    }
}

#[derive(Serialize, Deserialize, JsonSchema, Default)]
#[serde(default, deny_unknown_fields)]
pub struct NoParams {}

/// Mean of a row and its two neighbours.
pub struct Smooth;

impl Node for Smooth {
    const DECL: Decl = decl("refine/smooth", Grain::Row { halo: 1 });
    head!(Smooth, Plane => Plane; plans its plane);
    fn run(&self, input: Plane, cx: &Context) -> Result<Plane, NodeError> {
        let all = input.plane.meta.extent.rows();
        let around = input.plane.read(cx.rows().with_halo(1, all))?;
        let mut band = MapBand::zeros(cx.rows(), &input.plane.meta);
        for y in cx.rows().iter() {
            let rows: Vec<u32> = [y.checked_sub(1), Some(y), Some(y + 1)]
                .into_iter()
                .flatten()
                .filter(|&y| y < all.end)
                .collect();
            for x in 0..input.plane.meta.extent.width as usize {
                band.row_mut(0, y)[x] =
                    rows.iter().map(|&y| around.row(0, y)[x]).sum::<f32>() / rows.len() as f32;
            }
            cx.advance(1)?;
        }
        Ok(Plane { plane: MapSet::in_memory(input.plane.meta.clone(), band) })
    }
}

/// The sign of each pixel: equal for many inputs.
pub struct Sign;

impl Node for Sign {
    const DECL: Decl = decl("refine/sign", Grain::Pixel);
    head!(Sign, Plane => Plane; plans its plane);
    fn run(&self, input: Plane, cx: &Context) -> Result<Plane, NodeError> {
        Ok(Plane { plane: map_pixels(&input.plane, cx, f32::signum)? })
    }
}

/// Couples all pixels of a plane wider than four columns: each becomes the plane's sum. Leaves pixels of
/// narrower ones alone.
pub struct Couple;

impl Node for Couple {
    const DECL: Decl = decl("refine/couple", Grain::Pixel);
    head!(Couple, Plane => Plane; plans its plane);
    fn grain(&self, inputs: &PortMetas) -> Grain {
        if matches!(plane_meta(inputs), Meta::Map(map) if map.extent.width > 4) {
            Grain::Whole
        } else {
            Grain::Pixel
        }
    }
    fn run(&self, input: Plane, cx: &Context) -> Result<Plane, NodeError> {
        let extent = input.plane.meta.extent;
        if extent.width <= 4 {
            return Ok(Plane { plane: map_pixels(&input.plane, cx, |value| value)? });
        }
        let sum = input.plane.read(extent.rows())?.values.iter().sum();
        Ok(Plane { plane: map_pixels(&input.plane, cx, |_| sum)? })
    }
}

photocurrent_core::ports! {
    /// Two planes, and frames that never come.
    pub struct Halves {
        /// What is below the mean.
        low: MapSet,
        /// What is above.
        high: MapSet,
        /// Never there.
        frames: Option<FrameSequence>,
    }
}

/// Two outputs of one type, and an absent one.
pub struct Split;

impl Node for Split {
    const DECL: Decl = decl("split/halves", Grain::Pixel);
    head!(Split, Plane => Halves);
    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        let absent = Meta::Absent { data_type: DataType::Frames, why: "the toy has no frames".into() };
        Ok(vec![plane_meta(inputs), plane_meta(inputs), absent])
    }
    fn run(&self, input: Plane, cx: &Context) -> Result<Halves, NodeError> {
        let high = map_pixels(&input.plane, cx, |value| value.max(4.0))?;
        Ok(Halves { low: map_pixels(&input.plane, cx, |value| value.min(4.0))?, high, frames: None })
    }
}

/// Draws from the seed.
pub struct Noise;

impl Node for Noise {
    const DECL: Decl = Decl { draws: true, ..decl("simulate/noise", Grain::Pixel) };
    head!(Noise, Plane => Plane; plans its plane);
    fn run(&self, input: Plane, cx: &Context) -> Result<Plane, NodeError> {
        let mut band = input.plane.read(cx.rows())?;
        for y in cx.rows().iter() {
            for (x, value) in band.row_mut(0, y).iter_mut().enumerate() {
                *value += photocurrent_core::random::Random::new(cx.seed(), &[x as u64, u64::from(y)])
                    .uniform() as f32;
            }
        }
        Ok(Plane { plane: MapSet::in_memory(input.plane.meta.clone(), band) })
    }
}

photocurrent_core::ports! {
    /// Any number of planes.
    pub struct Planes {
        /// The planes.
        planes: Vec<MapSet>,
        /// Frames, which do not count.
        frames: Option<FrameSequence>,
    }
}
photocurrent_core::ports! {
    /// A table.
    pub struct Scores {
        /// The sums.
        scores: Arc<Table>,
    }
}

/// The sum of every plane, as a score.
pub struct Sum;

impl Node for Sum {
    const DECL: Decl = decl("score/sum", Grain::Whole);
    head!(Sum, Planes => Scores);
    fn plan(&self, _: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![Meta::Table(Arc::new(TableMeta { scores: true }))])
    }
    fn metrics(_: &Self::Params) -> Vec<String> {
        vec!["sum".into()]
    }
    fn run(&self, input: Planes, _: &Context) -> Result<Scores, NodeError> {
        let mut total = 0.0;
        let mut scores = Vec::new();
        for (i, plane) in input.planes.iter().enumerate() {
            let sum = plane.read(plane.rows())?.values.iter().map(|&value| f64::from(value)).sum::<f64>();
            scores.push(Score {
                metric: "sum".into(),
                frame: i as i64,
                t_ns: 0,
                value: sum,
                unit: "1".into(),
            });
            total += sum;
        }
        scores.push(Score { metric: "sum".into(), frame: -1, t_ns: 0, value: total, unit: "1".into() });
        Ok(Scores { scores: Arc::new(Table::scores(scores, "sum of all pixels")) })
    }
}

photocurrent_core::ports! {
    /// Frames.
    pub struct FramesOut {
        /// The frames.
        frames: FrameSequence,
    }
}

/// Another data type.
pub struct Frames;

impl Node for Frames {
    const DECL: Decl = decl("read/frames", Grain::Whole);
    head!(Frames, Nothing => FramesOut);
    fn plan(&self, _: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![Meta::Frames(testing::frames(3, 4, 2).meta)])
    }
    fn run(&self, _: Nothing, _: &Context) -> Result<FramesOut, NodeError> {
        Ok(FramesOut { frames: testing::frames(3, 4, 2) })
    }
}

/// Needs frames.
pub struct Grey;

impl Node for Grey {
    const DECL: Decl = decl("refine/grey", Grain::Frame);
    head!(Grey, FramesOut => FramesOut);
    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(vec![Meta::Frames(inputs.frames("frames")?.clone())])
    }
    fn run(&self, input: FramesOut, _: &Context) -> Result<FramesOut, NodeError> {
        Ok(input)
    }
}

/// Writes the numbers as text.
pub struct Write;

impl Node for Write {
    const DECL: Decl = Decl { exports: true, ..decl("write/text", Grain::Whole) };
    head!(Write, Plane => Nothing);
    fn plan(&self, _: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        Ok(Vec::new())
    }
    fn run(&self, input: Plane, cx: &Context) -> Result<Nothing, NodeError> {
        let band = input.plane.read(input.plane.rows())?;
        let folder = cx.export_dir()?.join("rows");
        std::fs::create_dir_all(&folder).map_err(|error| NodeError::files(error.to_string()))?;
        for y in band.rows().iter() {
            std::fs::write(folder.join(format!("{y:03}.txt")), format!("{:?}", band.row(0, y)))
                .map_err(|error| NodeError::files(error.to_string()))?;
        }
        Ok(Nothing {})
    }
}

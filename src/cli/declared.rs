//! Arguments that state what a recording's file does not: the same for every command that reads one.

use crate::failure::Failure;
use clap::Args as ClapArgs;
use photocurrent_core::Extent;
use photocurrent_core::quantity::{Duration, InputPath};
use photocurrent_formats::{
    Column, Counter, Declared, Mirror, Pairing, Polarity, Shift, StampRole, Strobe, TimeUnit, Transfer,
};
use photocurrent_nodes::read::foreign::{All, Size};
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};

/// What the user states; a fact that is not given is taken from the file, or asked for.
#[derive(ClapArgs, Clone, Debug, Default)]
pub struct DeclaredOptions {
    /// Size of the event pixel array, such as 346x260
    #[arg(long, value_name = "WxH", value_parser = extent)]
    pub extent: Option<Extent>,
    /// Unit of the stamps: s, ms, us or ns
    #[arg(long, value_name = "UNIT", value_parser = word::<TimeUnit>)]
    pub time_unit: Option<TimeUnit>,
    /// Columns of a text file from the left: t, x, y, p, t_in, skip
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = word::<Column>)]
    pub columns: Option<Vec<Column>>,
    /// Stored coordinates count this many to a pixel
    #[arg(long, value_name = "N")]
    pub coordinate_scale: Option<u32>,
    /// Camera, topic or stream of a file with several
    #[arg(long, value_name = "NAME")]
    pub camera: Option<String>,
    /// Image topic or stream of a file with several
    #[arg(long, value_name = "NAME")]
    pub frame_camera: Option<String>,
    /// Frames in a place of their own: a folder of pictures, a Y4M file
    #[arg(long, value_name = "PATH")]
    pub frames: Option<PathBuf>,
    /// Stamps of those frames: a text file
    #[arg(long, value_name = "FILE")]
    pub stamps: Option<PathBuf>,
    /// The trigger line whose edges are the exposures of those frames
    #[arg(long, value_name = "N")]
    pub trigger_line: Option<u16>,
    /// Length of a frame's exposure, such as "5 ms"
    #[arg(long, value_name = "TIME")]
    pub exposure: Option<Duration>,
    /// What a frame's one stamp means: start, middle or end of its exposure
    #[arg(long, value_name = "ROLE", value_parser = word::<StampRole>)]
    pub stamp: Option<StampRole>,
    /// How stored values follow from linear ones: linear, srgb, or a gamma such as 2.2
    #[arg(long, value_name = "CURVE", value_parser = transfer)]
    pub transfer: Option<Transfer>,
    /// Delay from one row's exposure to the next, such as "10 us"; 0 is a global shutter
    #[arg(long, value_name = "TIME")]
    pub row_time: Option<Duration>,
    /// Added to every stamp of a frame, for clocks that begin apart
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    pub frame_offset: Option<Duration>,
    /// Unit of the frames' stamps: s, ms, us or ns; that of the events unless stated
    #[arg(long, value_name = "UNIT", value_parser = word::<TimeUnit>)]
    pub stamps_unit: Option<TimeUnit>,
    /// How frames are mirrored against events: left_right, top_bottom or both
    #[arg(long, value_name = "WAY", value_parser = word::<Mirror>)]
    pub mirror: Option<Mirror>,
    /// Pixels by which events lie right of and below the frames, such as 2,-1
    #[arg(long, value_name = "RIGHT,DOWN", value_parser = shift, allow_hyphen_values = true)]
    pub shift: Option<Shift>,
    /// Frames to leave out, numbered from 0: 3,17
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub skip_frames: Option<Vec<u32>>,
    /// Read events that are there twice once
    #[arg(long)]
    pub drop_duplicates: bool,
    /// Exchange ON and OFF, where ON means darker
    #[arg(long)]
    pub invert_polarity: bool,
    /// How polarity is stored: signs, counts or one_two; recognised where it is not given
    #[arg(long, value_name = "CODE", value_parser = word::<Polarity>)]
    pub polarity: Option<Polarity>,
    /// Number of the first column and row: 0 or 1
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1))]
    pub origin: Option<u32>,
    /// Counter of the stamps that begins again: us23, us24, us28, us31, us32, ns32, or none
    #[arg(long, value_name = "BITS", value_parser = word::<Counter>)]
    pub counter: Option<Counter>,
    /// Which level of the trigger line is an open shutter: active_high (rising opens) or active_low
    #[arg(long, value_name = "LEVEL", value_parser = word::<Strobe>)]
    pub strobe: Option<Strobe>,
    /// The pulse or stamp that belongs to the first picture, counted from 0; -1 where the first picture has
    /// none
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    pub first_pulse: Option<i64>,
    /// By what a missing picture, pulse or stamp is recognised: order, numbers, times, numbers_and_times
    #[arg(long, value_name = "BY", value_parser = word::<Pairing>)]
    pub pairing: Option<Pairing>,
}

impl DeclaredOptions {
    /// As the parameters of a reader node.
    pub fn parameters(&self, path: &Path) -> All {
        let place = |path: &Option<PathBuf>| path.as_ref().map(InputPath::new);
        All {
            path: InputPath::new(path),
            extent: self.extent.map(|extent| Size { width: extent.width, height: extent.height }),
            time_unit: self.time_unit,
            columns: self.columns.clone(),
            coordinate_scale: self.coordinate_scale,
            camera: self.camera.clone(),
            frame_camera: self.frame_camera.clone(),
            frames: place(&self.frames),
            stamps: place(&self.stamps),
            trigger_line: self.trigger_line,
            frame_offset: self.frame_offset,
            exposure: self.exposure,
            stamp: self.stamp,
            row_time: self.row_time,
            transfer: self.transfer,
            stamps_unit: self.stamps_unit,
            mirror: self.mirror,
            shift: self.shift,
            skip_frames: self.skip_frames.clone(),
            drop_duplicates: self.drop_duplicates.then_some(true),
            invert_polarity: self.invert_polarity.then_some(true),
            polarity: self.polarity,
            origin: self.origin,
            counter: self.counter,
            strobe: self.strobe,
            first_pulse: self.first_pulse,
            pairing: self.pairing,
            ..All::default()
        }
    }

    /// As the readers take it.
    pub fn declared(&self) -> Declared {
        self.parameters(Path::new("")).settings().declared
    }
}

/// A word of an enumeration, as it stands in manifests.
pub fn word<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    serde_json::from_value(text.into()).map_err(|error| error.to_string())
}

fn extent(text: &str) -> Result<Extent, String> {
    let numbers = text
        .split_once(['x', 'X'])
        .and_then(|(width, height)| Some((width.trim().parse().ok()?, height.trim().parse().ok()?)));
    match numbers {
        Some((width, height)) if width > 0 && height > 0 => Ok(Extent { width, height }),
        _ => Err(format!("`{text}` is no size; such as 346x260")),
    }
}

fn shift(text: &str) -> Result<Shift, String> {
    let numbers = text
        .split_once(',')
        .and_then(|(right, down)| Some((right.trim().parse().ok()?, down.trim().parse().ok()?)));
    numbers
        .map(|(right, down)| Shift { right, down })
        .ok_or_else(|| format!("`{text}` is no shift; two whole numbers of pixels such as 2,-1"))
}

fn transfer(text: &str) -> Result<Transfer, String> {
    match text {
        "linear" => Ok(Transfer::Linear),
        "srgb" => Ok(Transfer::Srgb),
        _ => match text
            .trim_start_matches("gamma")
            .trim_matches(|c: char| c == '(' || c == ')' || c == '=' || c == ' ')
            .parse::<f64>()
        {
            Ok(gamma) if gamma.is_finite() && gamma > 0.0 => Ok(Transfer::Gamma(gamma)),
            _ => Err(format!("`{text}` is no curve; give linear, srgb, or a gamma such as 2.2")),
        },
    }
}

/// A refusal of a reader, for the shell: 2 when the user must state something or it is no recording, 3 when
/// the file is damaged.
pub fn refused(error: &photocurrent_formats::FormatError) -> Failure {
    let flag = error
        .undeclared
        .map(|field| format!("\n  state it: --{} ...", field.replace('_', "-")))
        .unwrap_or_default();
    Failure::Other { message: format!("{error}{flag}"), code: if error.undeclared.is_some() { 2 } else { 3 } }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_and_sizes_are_those_of_manifests() {
        assert_eq!(word::<TimeUnit>("us"), Ok(TimeUnit::Us));
        assert_eq!(word::<Column>("t_in"), Ok(Column::TIn));
        assert!(word::<Column>("time").unwrap_err().contains("t_in"));
        assert_eq!(extent("346x260"), Ok(Extent { width: 346, height: 260 }));
        assert!(extent("0x3").is_err() && extent("346").is_err());
        assert_eq!((transfer("2.2"), transfer("srgb")), (Ok(Transfer::Gamma(2.2)), Ok(Transfer::Srgb)));
        assert!(transfer("cubic").is_err());
    }
}

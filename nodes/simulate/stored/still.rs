//! One stored picture as relative light: PNG, TIFF or JPEG, grey or RGB, 8 or 16 bits; fewer bits and
//! palettes are widened to 8.

use super::{Curve, refused, short_name};
use photocurrent_core::{Colour, Extent, NodeError, Rows, colour};
use photocurrent_formats::pictures::decode;
use std::path::Path;

/// The size of a picture, from its header, if it is whole.
///
/// # Errors
/// When the file cannot be read, is no picture, is cut off, has transparency or more bits.
pub fn extent(path: &Path) -> Result<Extent, NodeError> {
    let head = decode::head(path).map_err(refused)?;
    let refuse = |why: String, hint: &str| {
        Err(NodeError::input(format!("{} has {why}", short_name(path))).hint(hint).param("path"))
    };
    if head.has_alpha {
        return refuse(
            "transparency, and light has none".into(),
            "save it without an alpha channel: grey or RGB, 8 or 16 bits",
        );
    }
    if head.bits > 16 {
        return refuse(
            format!("values of {} bits", head.bits),
            "save it with 8 or 16 bits a value: what is white in it is not known otherwise",
        );
    }
    Ok(head.extent)
}

/// Calls `each` with the relative light of some rows, from top to bottom; of colours, the luminance.
///
/// # Errors
/// As [`extent`], and when the picture is damaged or has fewer rows.
pub fn read(path: &Path, curve: &Curve, rows: Rows, each: &mut dyn FnMut(&[f64])) -> Result<(), NodeError> {
    let mut grey = Vec::new();
    read_colour(path, curve, rows, &mut |light| {
        grey.clear();
        grey.extend(light.chunks_exact(3).map(|rgb| luminance([rgb[0], rgb[1], rgb[2]])));
        each(&grey);
    })
}

/// The same with red, green and blue of each pixel, which are alike in grey pictures.
///
/// # Errors
/// As [`read`].
pub fn read_colour(
    path: &Path,
    curve: &Curve,
    rows: Rows,
    each: &mut dyn FnMut(&[f64]),
) -> Result<(), NodeError> {
    let mut light = Vec::new();
    let read = decode::rows(path, rows, &mut |head, values| {
        let table = curve.of(head.bits);
        let share = |value: &f32| table[(*value as usize).min(table.len() - 1)];
        light.clear();
        match head.colour {
            Colour::Rgb => light.extend(values.iter().map(share)),
            _ => light.extend(values.iter().flat_map(|value| [share(value); 3])),
        }
        each(&light);
    });
    read.map_err(refused)
}

/// Luminance of linear red, green and blue; grey stays exactly what it is.
pub fn luminance([red, green, blue]: [f64; 3]) -> f64 {
    // The weights add up to one but for rounding.
    let grey = red == green && green == blue;
    if grey { red } else { colour::luminance([red, green, blue]) }
}

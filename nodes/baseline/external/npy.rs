//! One picture in a NumPy `.npy` file: [height, width] or [height, width, 3] of u1, u2, f4 or f8,
//! little-endian, in C order.

use crate::simulate::stored::{cannot_read, short_name};
use photocurrent_core::{Extent, NodeError};
use std::path::Path;

/// A picture as stored.
pub struct Npy {
    /// Its size.
    pub extent: Extent,
    values: Vec<f64>,
    is_colour: bool,
    /// What is white unless somebody says otherwise.
    white: f64,
}

impl Npy {
    /// Reads a file.
    ///
    /// # Errors
    /// When it cannot be read, is damaged, or holds something else than a picture.
    pub fn open(path: &Path) -> Result<Npy, NodeError> {
        let bytes = std::fs::read(path).map_err(|error| cannot_read(path, &error))?;
        Npy::parse(&bytes).map_err(|what| {
            NodeError::input(format!("{} {what}", short_name(path)))
                .hint(
                    "save each picture by itself: `numpy.save(name, picture)` with a [height, width] \
                       or [height, width, 3] array of uint8, uint16, float32 or float64",
                )
                .param("path")
        })
    }

    fn parse(bytes: &[u8]) -> Result<Npy, String> {
        let damaged = || "is no `.npy` file".to_string();
        let version = bytes.strip_prefix(b"\x93NUMPY").and_then(|rest| rest.first()).ok_or_else(damaged)?;
        let (start, length) = match version {
            1 => (10, bytes.get(8..10).map(|b| usize::from(u16::from_le_bytes([b[0], b[1]])))),
            _ => (12, bytes.get(8..12).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize)),
        };
        let end = length.and_then(|length| length.checked_add(start)).ok_or_else(damaged)?;
        let header =
            bytes.get(start..end).and_then(|header| std::str::from_utf8(header).ok()).ok_or_else(damaged)?;
        let data = &bytes[end..];
        let after = |key: &str| header.split_once(&format!("'{key}':")).map(|(_, rest)| rest.trim_start());
        let descr = after("descr")
            .and_then(|rest| rest.strip_prefix('\''))
            .and_then(|rest| rest.split_once('\''))
            .map(|(descr, _)| descr)
            .ok_or_else(damaged)?;
        if after("fortran_order").is_none_or(|rest| !rest.starts_with("False")) {
            return Err("is in column order (fortran_order)".into());
        }
        let shape = after("shape")
            .and_then(|rest| rest.strip_prefix('('))
            .and_then(|rest| rest.split_once(')'))
            .map(|(shape, _)| shape)
            .ok_or_else(damaged)?;
        let sizes: Vec<u32> = shape.split(',').filter_map(|size| size.trim().parse().ok()).collect();
        let (height, width, channels) = match sizes[..] {
            [height, width] => (height, width, 1),
            [height, width, 3] => (height, width, 3),
            _ => {
                return Err(format!(
                    "has the shape ({shape}), and a picture has (height, width) or (height, width, 3)"
                ));
            }
        };
        let count = height as usize * width as usize * channels;
        let (size, white) = match descr {
            "|u1" => (1, 255.0),
            "<u2" => (2, 65535.0),
            "<f4" => (4, 1.0),
            "<f8" => (8, 1.0),
            other => return Err(format!("holds '{other}', and u1, <u2, <f4 or <f8 is read")),
        };
        if data.len() != count * size || count == 0 {
            return Err(format!("has {} bytes of data, and {count} numbers are announced", data.len()));
        }
        let value = |b: &[u8]| match *b {
            [a] => f64::from(a),
            [a, b] => f64::from(u16::from_le_bytes([a, b])),
            [a, b, c, d] => f64::from(f32::from_le_bytes([a, b, c, d])),
            [a, b, c, d, e, f, g, h] => f64::from_le_bytes([a, b, c, d, e, f, g, h]),
            _ => f64::NAN,
        };
        Ok(Npy {
            extent: Extent { width, height },
            values: data.chunks_exact(size).map(value).collect(),
            is_colour: channels == 3,
            white,
        })
    }

    /// The values with white as 1, of each pixel red, green and blue, which are alike in grey pictures;
    /// `white` is the stored value that is white, when it is stated.
    pub fn light(self, white: Option<f64>) -> Vec<f64> {
        let white = white.unwrap_or(self.white);
        let share = |value: f64| value / white;
        if self.is_colour {
            self.values.into_iter().map(share).collect()
        } else {
            self.values.into_iter().flat_map(|value| [share(value); 3]).collect()
        }
    }
}

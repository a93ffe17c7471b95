//! Which colours the values of a picture have: one grey value a pixel, three values, or one behind a mosaic
//! of filters.
//!
//! The channels are 0 red, 1 green, 2 blue. A Bayer mosaic repeats a cell of 2 x 2 pixels; in a quad-Bayer
//! mosaic each filter covers 2 x 2 pixels, so the cell has 4 x 4. A mosaic's name ends with the colours of
//! its cell, row by row: `rggb` begins with red, `gbrg` with green above red.

#[cfg(feature = "graph")]
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
#[cfg(feature = "graph")]
use std::borrow::Cow;
use std::fmt;

/// What linear red, green and blue count in luminance.
pub const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Luminance of linear red, green and blue.
pub fn luminance([red, green, blue]: [f64; 3]) -> f64 {
    LUMINANCE[0] * red + LUMINANCE[1] * green + LUMINANCE[2] * blue
}

/// Where the colours of a mosaic stand in its cell, row by row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Order {
    /// Red first.
    Rggb,
    /// Blue first.
    Bggr,
    /// Green first, red next to it.
    Grbg,
    /// Green first, blue next to it.
    Gbrg,
}

impl Order {
    /// The channel at a place of the 2 x 2 cell.
    fn channel(self, x: u32, y: u32) -> usize {
        let cell = match self {
            Order::Rggb => [0, 1, 1, 2],
            Order::Bggr => [2, 1, 1, 0],
            Order::Grbg => [1, 0, 2, 1],
            Order::Gbrg => [1, 2, 0, 1],
        };
        cell[((y & 1) * 2 + (x & 1)) as usize]
    }
}

/// The colours of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(into = "&'static str", try_from = "String")]
pub enum Colour {
    /// One grey value a pixel.
    #[default]
    Mono,
    /// Red, green and blue of every pixel.
    Rgb,
    /// One value a pixel, behind filters that alternate from pixel to pixel.
    Bayer(Order),
    /// One value a pixel, behind filters of 2 x 2 pixels.
    QuadBayer(Order),
}

/// Every colour and its name in files.
const NAMES: [(Colour, &str); 10] = [
    (Colour::Mono, "mono"),
    (Colour::Rgb, "rgb"),
    (Colour::Bayer(Order::Rggb), "bayer_rggb"),
    (Colour::Bayer(Order::Bggr), "bayer_bggr"),
    (Colour::Bayer(Order::Grbg), "bayer_grbg"),
    (Colour::Bayer(Order::Gbrg), "bayer_gbrg"),
    (Colour::QuadBayer(Order::Rggb), "quad_bayer_rggb"),
    (Colour::QuadBayer(Order::Bggr), "quad_bayer_bggr"),
    (Colour::QuadBayer(Order::Grbg), "quad_bayer_grbg"),
    (Colour::QuadBayer(Order::Gbrg), "quad_bayer_gbrg"),
];

impl Colour {
    /// The name in files: `mono`, `rgb`, `bayer_rggb`, `quad_bayer_rggb` ...
    pub fn name(self) -> &'static str {
        NAMES.iter().find(|(colour, _)| *colour == self).expect("every colour has a name").1
    }

    /// By its name.
    pub fn named(name: &str) -> Option<Colour> {
        NAMES.iter().find(|(_, known)| *known == name).map(|(colour, _)| *colour)
    }

    /// All names, for messages.
    pub fn names() -> impl Iterator<Item = &'static str> {
        NAMES.iter().map(|(_, name)| *name)
    }

    /// Values of a pixel: three for `rgb`, one for all others.
    pub fn channels(self) -> u32 {
        if self == Colour::Rgb { 3 } else { 1 }
    }

    /// Is each pixel behind one filter of several?
    pub fn is_mosaic(self) -> bool {
        self.cell() > 1
    }

    /// Pixels along the side of the cell that repeats: 1 without a mosaic.
    pub fn cell(self) -> u32 {
        match self {
            Colour::Mono | Colour::Rgb => 1,
            Colour::Bayer(_) => 2,
            Colour::QuadBayer(_) => 4,
        }
    }

    /// The channel of a value in row `y`, counted as they stand in a row (`x * channels + channel`); `None`
    /// for grey.
    ///
    /// ```
    /// use photocurrent_core::colour::Colour;
    /// let quad = Colour::named("quad_bayer_grbg").unwrap();
    /// assert_eq!([0, 1, 2, 3, 4].map(|x| quad.channel(x, 0)), [1, 1, 0, 0, 1].map(Some));
    /// assert_eq!(Colour::Rgb.channel(5, 0), Some(2));
    /// ```
    pub fn channel(self, value: u32, y: u32) -> Option<usize> {
        match self {
            Colour::Mono => None,
            Colour::Rgb => Some((value % 3) as usize),
            Colour::Bayer(order) => Some(order.channel(value, y)),
            Colour::QuadBayer(order) => Some(order.channel(value / 2, y / 2)),
        }
    }
}

#[cfg(feature = "graph")]
impl JsonSchema for Colour {
    fn schema_name() -> Cow<'static, str> {
        "Colour".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "string", "enum": Colour::names().collect::<Vec<_>>() })
    }
}

impl fmt::Display for Colour {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl From<Colour> for &'static str {
    fn from(colour: Colour) -> &'static str {
        colour.name()
    }
}

impl TryFrom<String> for Colour {
    type Error = String;

    fn try_from(name: String) -> Result<Colour, String> {
        Colour::named(&name).ok_or_else(|| {
            format!(
                "`{name}` is no colour of pictures; known are {}",
                Colour::names().collect::<Vec<_>>().join(", ")
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each mosaic's upper left cell, written out by hand.
    #[test]
    fn cells_are_as_their_names_say() {
        let row = |name: &str, y: u32| -> String {
            (0..4).map(|x| ['r', 'g', 'b'][Colour::named(name).unwrap().channel(x, y).unwrap()]).collect()
        };
        let cell = |name: &str| (0..4).map(|y| row(name, y)).collect::<Vec<_>>().join(" ");
        assert_eq!(cell("bayer_rggb"), "rgrg gbgb rgrg gbgb");
        assert_eq!(cell("bayer_bggr"), "bgbg grgr bgbg grgr");
        assert_eq!(cell("bayer_grbg"), "grgr bgbg grgr bgbg");
        assert_eq!(cell("bayer_gbrg"), "gbgb rgrg gbgb rgrg");
        assert_eq!(cell("quad_bayer_rggb"), "rrgg rrgg ggbb ggbb");
        assert_eq!(cell("quad_bayer_gbrg"), "ggbb ggbb rrgg rrgg");
    }

    #[test]
    fn a_name_leads_to_its_colour_and_back() {
        for name in Colour::names() {
            let colour = Colour::named(name).unwrap();
            assert_eq!(serde_json::to_value(colour).unwrap(), name);
            assert_eq!(serde_json::from_value::<Colour>(name.into()).unwrap(), colour);
        }
        let error = serde_json::from_value::<Colour>("rgbw".into()).unwrap_err().to_string();
        assert!(
            error.starts_with("`rgbw` is no colour of pictures; known are mono, rgb, bayer_rggb"),
            "{error}"
        );
    }
}

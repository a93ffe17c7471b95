//! Luma and chroma of BT.709: the one place where Y'CbCr becomes R'G'B', and R'G'B' becomes Y'CbCr.
//!
//! BT.709 for every file: HD films use it, and `write/video` writes it. A Y4M header has no agreed word for
//! the matrix; films of standard definition may mean BT.601, whose pure red has 9 percent of green when it is
//! read as BT.709. Readers name the matrix in a note.
//!
//! Source: ITU-R BT.709-6, items 3.2 to 3.5 (the matrix, limited range); full range stretches luma and chroma
//! over all numbers, as JFIF does.

use photocurrent_core::colour::LUMINANCE;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What notes call the matrix.
pub const MATRIX: &str = "BT.709";

/// Which stored luma is black and white.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Range {
    /// 16 to 235 of 8 bits, chroma 16 to 240.
    Limited,
    /// 0 to 255 of 8 bits.
    Full,
}

/// What stored numbers of some range and bits stand for; shares of white are 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Levels {
    black: f64,
    /// White less black.
    swing: f64,
    /// Chroma of no colour.
    middle: u16,
    /// The most chroma less the least.
    chroma_swing: f64,
    /// The largest number.
    most: f64,
}

impl Levels {
    /// Of `bits`, 8 to 16.
    pub fn new(range: Range, bits: u32) -> Levels {
        let unit = f64::from(1_u32 << (bits - 8));
        let most = f64::from((1_u32 << bits) - 1);
        let middle = 1 << (bits - 1);
        match range {
            Range::Limited => {
                Levels { black: 16.0 * unit, swing: 219.0 * unit, middle, chroma_swing: 224.0 * unit, most }
            }
            Range::Full => Levels { black: 0.0, swing: most, middle, chroma_swing: most, most },
        }
    }

    /// Stored numbers of black and white.
    pub fn ends(self) -> [f64; 2] {
        [self.black, self.black + self.swing]
    }

    /// The largest number.
    pub fn most(self) -> f64 {
        self.most
    }

    /// Chroma of no colour.
    pub fn middle(self) -> u16 {
        self.middle
    }

    /// Stored luma as a share of white; below black is less than 0, above white more than 1.
    pub fn luma(self, stored: u16) -> f64 {
        (f64::from(stored) - self.black) / self.swing
    }

    /// Red, green and blue as shares of white, of stored luma and the chroma of blue and of red.
    pub fn rgb(self, [luma, blue, red]: [u16; 3]) -> [f64; 3] {
        let luma = self.luma(luma);
        let chroma = |stored: u16| (f64::from(stored) - f64::from(self.middle)) / self.chroma_swing;
        let [weight_red, weight_green, weight_blue] = LUMINANCE;
        let red = luma + 2.0 * (1.0 - weight_red) * chroma(red);
        let blue = luma + 2.0 * (1.0 - weight_blue) * chroma(blue);
        let green = (luma - weight_red * red - weight_blue * blue) / weight_green;
        [red, green, blue]
    }

    /// The stored luma of a grey; `white` is what it would be if it were white.
    pub fn stored_luma(self, grey: f64, white: f64) -> u16 {
        self.stored(self.black + self.swing / white * grey)
    }

    /// Stored luma and the chroma of blue and of red, of a colour whose values are `white` where it is white.
    pub fn ycbcr(self, [red, green, blue]: [f64; 3], white: f64) -> [u16; 3] {
        let [weight_red, weight_green, weight_blue] = LUMINANCE;
        let luma = weight_red * red + weight_green * green + weight_blue * blue;
        let chroma = |difference: f64, weight: f64| {
            self.stored(
                f64::from(self.middle) + self.chroma_swing / white * difference / (2.0 * (1.0 - weight)),
            )
        };
        [self.stored_luma(luma, white), chroma(blue - luma, weight_blue), chroma(red - luma, weight_red)]
    }

    fn stored(self, value: f64) -> u16 {
        value.round().clamp(0.0, self.most) as u16
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLOURS: [[f64; 3]; 8] = [
        [1.0, 1.0, 1.0],
        [1.0, 1.0, 0.0],
        [0.0, 1.0, 1.0],
        [0.0, 1.0, 0.0],
        [1.0, 0.0, 1.0],
        [1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.0, 0.0, 0.0],
    ];

    #[test]
    fn the_bars_of_the_standard_have_its_numbers() {
        // 100 percent bars of BT.709 as test patterns print them: white, yellow, cyan, green, magenta, red,
        // blue, black.
        let eight: [[u16; 3]; 8] = [
            [235, 128, 128],
            [219, 16, 138],
            [188, 154, 16],
            [173, 42, 26],
            [78, 214, 230],
            [63, 102, 240],
            [32, 240, 118],
            [16, 128, 128],
        ];
        let ten: [[u16; 3]; 8] = [
            [940, 512, 512],
            [877, 64, 553],
            [754, 615, 64],
            [691, 167, 105],
            [313, 857, 919],
            [250, 409, 960],
            [127, 960, 471],
            [64, 512, 512],
        ];
        for (bits, bars, tolerance) in [(8, eight, 0.01), (10, ten, 0.0025)] {
            let levels = Levels::new(Range::Limited, bits);
            assert_eq!(COLOURS.map(|rgb| levels.ycbcr(rgb, 1.0)), bars);
            for (bar, rgb) in bars.into_iter().zip(COLOURS) {
                assert!(
                    levels
                        .rgb(bar)
                        .iter()
                        .zip(rgb)
                        .all(|(found, expected)| (found - expected).abs() < tolerance),
                    "{bits} bits, {bar:?}"
                );
            }
        }
    }

    #[test]
    fn every_range_and_depth_gives_colours_back_within_its_steps() {
        for (range, bits) in [Range::Limited, Range::Full]
            .into_iter()
            .flat_map(|range| [8, 9, 10, 12, 16].map(|bits| (range, bits)))
        {
            let levels = Levels::new(range, bits);
            // Half a step of luma, and of chroma times 1.8556 at most, over the smallest of the swings.
            let most = 0.5 * (1.0 + 1.8556) / (219.0 * f64::from(1_u32 << (bits - 8)));
            for k in 0..1000_u32 {
                let rgb = [k % 10, k / 10 % 10, k / 100].map(|ninths| f64::from(ninths) / 9.0);
                let found = levels.rgb(levels.ycbcr(rgb.map(|share| 255.0 * share), 255.0));
                assert!(
                    found.iter().zip(rgb).all(|(found, expected)| (found - expected).abs() <= most),
                    "{range:?}, {bits} bits: {rgb:?}, {found:?}"
                );
            }
        }
    }
}

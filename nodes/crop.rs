//! A rectangle of pixels, as a parameter.

use photocurrent_core::{Extent, NodeError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A part of a picture, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Crop {
    /// Leftmost column, counted from 0.
    pub x: u32,
    /// Topmost row, counted from 0.
    pub y: u32,
    /// Number of columns, 1 or more.
    #[schemars(range(min = 1))]
    pub width: u32,
    /// Number of rows, 1 or more.
    #[schemars(range(min = 1))]
    pub height: u32,
}

impl Crop {
    /// Of a whole picture.
    pub fn whole(extent: Extent) -> Crop {
        Crop { x: 0, y: 0, width: extent.width, height: extent.height }
    }

    /// Refuses a rectangle that is not inside `pictures` (what messages call them); `param` states it.
    ///
    /// # Errors
    /// When it is empty or reaches beyond a border.
    pub fn check(self, param: &str, pictures: &str, extent: Extent) -> Result<(), NodeError> {
        let fits = |start: u32, size: u32, whole: u32| size > 0 && start < whole && size <= whole - start;
        if fits(self.x, self.width, extent.width) && fits(self.y, self.height, extent.height) {
            return Ok(());
        }
        let asked = self.describe();
        Err(NodeError::usage(format!("`{param}` asks for {asked}, and the {pictures} have {extent}"))
            .hint(format!(
                "keep `x + width` within {}, and `y + height` within {}",
                extent.width, extent.height
            ))
            .param(param))
    }

    /// Is a pixel inside?
    pub fn contains(self, x: u32, y: u32) -> bool {
        x >= self.x && y >= self.y && x - self.x < self.width && y - self.y < self.height
    }

    /// For the card.
    pub fn describe(self) -> String {
        format!("{} x {} pixels at ({}, {})", self.width, self.height, self.x, self.y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rectangle_reaches_to_the_last_pixel_and_not_beyond() {
        let extent = Extent { width: 10, height: 8 };
        let crop = |x, y, width, height| Crop { x, y, width, height };
        for inside in [crop(0, 0, 10, 8), crop(9, 7, 1, 1), Crop::whole(extent)] {
            assert!(inside.check("roi", "frames", extent).is_ok(), "{inside:?}");
        }
        for outside in [
            crop(0, 0, 11, 8),
            crop(0, 1, 10, 8),
            crop(10, 0, 1, 1),
            crop(0, 0, 0, 1),
            crop(5, 0, u32::MAX, 1),
        ] {
            let error = outside.check("roi", "frames", extent).unwrap_err();
            assert_eq!(error.param.as_deref(), Some("roi"), "{outside:?}");
            assert!(error.message.ends_with("and the frames have 10 x 8"), "{}", error.message);
        }
    }
}

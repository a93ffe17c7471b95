//! The light of an event pixel that lies on several frame pixels: a weighted sum of theirs.
//!
//! On a hybrid sensor, the photodiodes of a block of frame pixels feed one event pixel, or lie so near to its
//! own that the paper takes their light for the same (Section 3). Behind a mosaic of filters, the block's
//! pixels see different colours, so the event pixel sees a fixed mixture of them. The mixture is a mean: grey
//! light is as strong for the event pixel as for each frame pixel, whatever the weights.
//!
//! A frame pixel sees its own colour at its own place. As long as neither colour nor the pattern inside the
//! block changes, its light is the event pixel's times one factor, so that steps of log light are the same
//! for both: that is what lets an event stand for each pixel of its block. It fails where an edge between two
//! colours of like brightness passes (frames change, no event fires), and where an edge crosses the block's
//! pixels one after the other.

use photocurrent_core::Colour;

/// How much each value of a block counts in the light of its event pixel:
/// [row of the block][value in the row], values as they stand in a row of the frame
/// (`x * channels + channel`); positive or zero, 1 in all.
///
/// `ratio` frame pixels lie along the side of the block at column `x` and row `y` of the events. `seen` is
/// how strongly the event pixel sees red, green and blue, per channel and not per photodiode; absent, every
/// photodiode counts alike. A colour that the block does not have is left out; where none is left that
/// counts, all count alike.
///
/// ```
/// # use photocurrent_core::Colour;
/// # use photocurrent_sensor::pooling::block_weights;
/// let bayer = Colour::named("bayer_rggb").unwrap();
/// // Two green photodiodes share what green counts.
/// assert_eq!(block_weights(bayer, 2, (0, 0), Some([1.0, 2.0, 1.0])), [0.25, 0.25, 0.25, 0.25]);
/// assert_eq!(block_weights(bayer, 2, (5, 3), Some([0.0, 1.0, 1.0])), [0.0, 0.25, 0.25, 0.5]);
/// ```
pub fn block_weights(colour: Colour, ratio: u32, (x, y): (u32, u32), seen: Option<[f64; 3]>) -> Vec<f64> {
    let row_values = ratio * colour.channels();
    let channels: Vec<Option<usize>> = (0..ratio)
        .flat_map(|row| {
            (0..row_values).map(move |value| colour.channel(x * row_values + value, y * ratio + row))
        })
        .collect();
    let weight = |channel: Option<usize>| match (channel, seen) {
        (Some(channel), Some(seen)) => {
            seen[channel] / channels.iter().filter(|other| **other == Some(channel)).count() as f64
        }
        _ => 1.0,
    };
    let weights: Vec<f64> = channels.iter().map(|channel| weight(*channel)).collect();
    let sum: f64 = weights.iter().sum();
    if sum > 0.0 {
        weights.iter().map(|weight| weight / sum).collect()
    } else {
        vec![1.0 / weights.len() as f64; weights.len()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_a_mean_for_every_colour_and_ratio() {
        for name in Colour::names() {
            let colour = Colour::named(name).unwrap();
            for ratio in 1..=5 {
                for seen in [None, Some([0.2, 0.5, 0.3]), Some([0.0, 0.0, 1.0])] {
                    for place in [(0, 0), (1, 0), (4, 7)] {
                        let weights = block_weights(colour, ratio, place, seen);
                        assert_eq!(weights.len() as u32, ratio * ratio * colour.channels());
                        assert!(
                            (weights.iter().sum::<f64>() - 1.0).abs() < 1e-12
                                && weights.iter().all(|weight| *weight >= 0.0)
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn a_block_inside_one_filter_sees_one_colour() {
        let quad = Colour::named("quad_bayer_rggb").unwrap();
        // The block at (1, 0) is green only: its four photodiodes share it, whatever red counts.
        assert_eq!(block_weights(quad, 2, (1, 0), Some([5.0, 1.0, 5.0])), [0.25; 4]);
        // Red does not count at all: its block still sees light.
        assert_eq!(block_weights(quad, 2, (0, 0), Some([0.0, 1.0, 1.0])), [0.25; 4]);
    }

    #[test]
    fn three_channels_of_one_pixel_are_mixed_as_stated() {
        let weights = block_weights(Colour::Rgb, 1, (3, 2), Some([0.3, 0.6, 0.1]));
        assert!(
            weights.iter().zip([0.3, 0.6, 0.1]).all(|(found, stated)| (found - stated).abs() < 1e-15),
            "{weights:?}"
        );
    }
}

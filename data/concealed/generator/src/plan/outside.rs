//! The entries of the plan `outside`: each of 28 dependences twice, on a scene in which one picture moves and
//! on one in which nothing moves as one, once with noisy frames and once without noise.

use super::{Entry, unnamed};

/// Are the frames of a recording noisy, and does its description state it?
pub fn is_noisy(index: usize) -> [bool; 2] {
    let (copy, law) = (index / LAWS, index % LAWS);
    [(law / FAMILIES.len() + copy).is_multiple_of(2), (law / (2 * FAMILIES.len())).is_multiple_of(2)]
}

/// Dependences, each of which is there twice.
const LAWS: usize = 28;
/// Kinds of scene, which follow each other.
const FAMILIES: [&str; 4] = ["texture", "layers", "photograph", "water"];

pub const OUTSIDE: &[Entry] = &[
    unnamed("hysteresis", "texture"),
    unnamed("frame_kick", "layers"),
    unnamed("row_parity", "photograph"),
    unnamed("fatigue", "water"),
    unnamed("column_block", "texture"),
    unnamed("neighbour_delay", "layers"),
    unnamed("ripple", "photograph"),
    unnamed("row_reset", "water"),
    unnamed("spatial_gradient", "texture"),
    unnamed("global_rate", "layers"),
    unnamed("row_rate", "photograph"),
    unnamed("polarity_delay", "water"),
    unnamed("light", "texture"),
    unnamed("radius", "layers"),
    unnamed("slow_comparator", "photograph"),
    unnamed("telegraph", "water"),
    unnamed("lag", "texture"),
    unnamed("time_step", "layers"),
    unnamed("warming", "photograph"),
    unnamed("row_band", "water"),
    unnamed("column_wave", "texture"),
    unnamed("radius_off", "layers"),
    unnamed("row_leak", "photograph"),
    unnamed("row_loss", "water"),
    unnamed("dim_noise", "texture"),
    unnamed("parity_delay", "layers"),
    unnamed("delay_wave", "photograph"),
    unnamed("column_gain", "water"),
    unnamed("hysteresis", "layers"),
    unnamed("frame_kick", "photograph"),
    unnamed("row_parity", "water"),
    unnamed("fatigue", "texture"),
    unnamed("column_block", "layers"),
    unnamed("neighbour_delay", "photograph"),
    unnamed("ripple", "water"),
    unnamed("row_reset", "texture"),
    unnamed("spatial_gradient", "layers"),
    unnamed("global_rate", "photograph"),
    unnamed("row_rate", "water"),
    unnamed("polarity_delay", "texture"),
    unnamed("light", "layers"),
    unnamed("radius", "photograph"),
    unnamed("slow_comparator", "water"),
    unnamed("telegraph", "texture"),
    unnamed("lag", "layers"),
    unnamed("time_step", "photograph"),
    unnamed("warming", "water"),
    unnamed("row_band", "texture"),
    unnamed("column_wave", "layers"),
    unnamed("radius_off", "photograph"),
    unnamed("row_leak", "water"),
    unnamed("row_loss", "texture"),
    unnamed("dim_noise", "layers"),
    unnamed("parity_delay", "photograph"),
    unnamed("delay_wave", "water"),
    unnamed("column_gain", "texture"),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::views::View;

    #[test]
    fn each_dependence_is_there_with_and_without_noise_and_with_and_without_one_motion() {
        assert_eq!(OUTSIDE.len(), 2 * LAWS);
        for law in 0..LAWS {
            let [one, other] = [law, law + LAWS].map(|index| (OUTSIDE[index], is_noisy(index)[0], index));
            assert_eq!(one.0.law, other.0.law);
            assert_ne!(one.1, other.1, "{law}");
            for (entry, _, index) in [one, other] {
                assert_eq!(entry.family, FAMILIES[(index + index / LAWS) % FAMILIES.len()]);
                assert!(View::NAMES.contains(&entry.family));
            }
        }
        // A kind of scene has as many noisy as clean ones.
        for family in FAMILIES {
            let noisy = |index: &usize| OUTSIDE[*index].family == family && is_noisy(*index)[0];
            assert_eq!((0..OUTSIDE.len()).filter(noisy).count(), 7, "{family}");
        }
    }
}

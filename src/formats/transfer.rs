//! From stored values to linear ones: the inverse of the curve that a camera or an encoder applied.
//!
//! Full scale stays full scale: 0 and the largest code are fixed points. The same bits come out on every
//! machine.

use crate::declared::Transfer;

impl Transfer {
    /// The linear value of a stored one, both of 0 to 1. Values outside are left as the curve continues them:
    /// sRGB's linear piece below 0.
    pub fn linear(self, stored: f64) -> f64 {
        match self {
            Transfer::Linear => stored,
            // IEC 61966-2-1: the linear piece ends at 0.04045 of the stored value.
            Transfer::Srgb if stored <= 0.040_45 => stored / 12.92,
            Transfer::Srgb => libm::pow((stored + 0.055) / 1.055, 2.4),
            Transfer::Gamma(_) if stored <= 0.0 => 0.0,
            Transfer::Gamma(gamma) => libm::pow(stored, gamma),
        }
    }

    /// The largest stored value of so many bits; 1 for floats (32 bits).
    pub fn full_scale(bits: u32) -> f64 {
        if bits == 0 || bits >= 32 { 1.0 } else { f64::from((1_u32 << bits) - 1) }
    }

    /// Makes codes of `bits` linear, in place, at the same full scale.
    pub fn linearise(self, values: &mut [f32], bits: u32) {
        let full = Transfer::full_scale(bits);
        match self {
            Transfer::Linear => {}
            // A picture has more pixels than codes: a table is quicker, and gives the same bits.
            _ if bits > 0 && bits <= 16 && values.len() >= 1 << bits => {
                let table: Vec<f32> = (0..1_u32 << bits)
                    .map(|code| (self.linear(f64::from(code) / full) * full) as f32)
                    .collect();
                for value in values {
                    let code = *value as usize;
                    *value = match table.get(code) {
                        Some(linear) if code as f32 == *value => *linear,
                        _ => self.one(*value, full),
                    };
                }
            }
            _ => {
                for value in values {
                    *value = self.one(*value, full);
                }
            }
        }
    }

    fn one(self, value: f32, full: f64) -> f32 {
        (self.linear(f64::from(value) / full) * full) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn full_scale_and_zero_stay() {
        for transfer in [Transfer::Linear, Transfer::Srgb, Transfer::Gamma(2.2)] {
            let mut values = [0.0, 255.0];
            transfer.linearise(&mut values, 8);
            assert_eq!(values, [0.0, 255.0], "{transfer:?}");
        }
    }

    #[test]
    fn the_curve_is_the_inverse_of_the_published_one() {
        // The encoder of IEC 61966-2-1, written out here.
        let encode = |linear: f64| {
            if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * libm::pow(linear, 1.0 / 2.4) - 0.055 }
        };
        for k in 0..=1000 {
            let linear = f64::from(k) / 1000.0;
            assert!((Transfer::Srgb.linear(encode(linear)) - linear).abs() < 1e-7, "{linear}");
            assert!((Transfer::Gamma(2.2).linear(libm::pow(linear, 1.0 / 2.2)) - linear).abs() < 1e-12);
        }
        // A mid grey of 188 is half the light (0.5029).
        assert!((Transfer::Srgb.linear(188.0 / 255.0) - 0.5029).abs() < 1e-4);
    }

    #[test]
    fn a_table_gives_the_same_bits_as_the_curve() {
        let codes: Vec<f32> = (0..256).map(|code| code as f32).chain([12.5, -3.0, 300.0]).collect();
        let mut together = codes.clone();
        Transfer::Srgb.linearise(&mut together, 8);
        for (code, linear) in codes.iter().zip(&together) {
            let mut one = [*code];
            Transfer::Srgb.linearise(&mut one, 8);
            assert_eq!(one[0].to_bits(), linear.to_bits(), "{code}");
        }
    }
}

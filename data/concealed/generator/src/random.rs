//! Random numbers: one small generator, seeded by text, so that every recording has streams of its own.
//!
//! SplitMix64 (Steele, Lea and Flood 2014): 64 bits of state, one stream a pixel costs eight bytes, and the
//! order in which pixels are visited changes nothing.

use crate::digest::sha256;

/// A stream of random numbers.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// The stream that belongs to `name`: equal names give equal streams, on every machine.
    pub fn named(name: &str) -> Self {
        let digest = sha256(name.as_bytes());
        Self(digest[..8].iter().fold(0, |bits, byte| bits << 8 | u64::from(*byte)))
    }

    /// A stream apart, drawn from this one.
    pub fn split(&mut self) -> Self {
        Self(self.bits())
    }

    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in (0, 1): neither end is drawn.
    pub fn unit(&mut self) -> f64 {
        ((self.bits() >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    /// Uniform in `low` .. `high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Log-uniform in `low` .. `high`, both positive.
    pub fn log_between(&mut self, low: f64, high: f64) -> f64 {
        low * libm::exp(self.unit() * libm::log(high / low))
    }

    /// A whole number below `n`.
    pub fn below(&mut self, n: usize) -> usize {
        ((self.unit() * n as f64) as usize).min(n - 1)
    }

    /// True with chance `chance`.
    pub fn chance(&mut self, chance: f64) -> bool {
        self.unit() < chance
    }

    /// +1 or -1.
    pub fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }

    /// Normal with mean 0 and standard deviation 1 (Box and Muller 1958).
    pub fn normal(&mut self) -> f64 {
        let radius = libm::sqrt(-2.0 * libm::log(self.unit()));
        radius * libm::cos(2.0 * std::f64::consts::PI * self.unit())
    }

    /// Exponential with this mean.
    pub fn exponential(&mut self, mean: f64) -> f64 {
        -mean * libm::log(self.unit())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_have_the_moments_of_their_laws() {
        let mut random = Random::named("moments");
        let n = 200_000;
        let (mut mean, mut square, mut wait, mut unit) = (0.0, 0.0, 0.0, 0.0);
        for _ in 0..n {
            let z = random.normal();
            mean += z / f64::from(n);
            square += z * z / f64::from(n);
            wait += random.exponential(3.0) / f64::from(n);
            unit += random.unit() / f64::from(n);
        }
        // Five standard errors each: 1/sqrt(n), sqrt(2/n), 3/sqrt(n), 1/sqrt(12 n).
        assert!(mean.abs() < 0.0112, "{mean}");
        assert!((square - 1.0).abs() < 0.0158, "{square}");
        assert!((wait - 3.0).abs() < 0.0336, "{wait}");
        assert!((unit - 0.5).abs() < 0.0033, "{unit}");
    }

    #[test]
    fn the_first_numbers_are_those_of_splitmix64() {
        // Reference outputs for the seed 1234567, as published with the algorithm's Java and C versions.
        let mut random = Random(1_234_567);
        assert_eq!([random.bits(), random.bits()], [6_457_827_717_110_365_317, 3_203_168_211_198_807_973]);
    }
}

//! Random numbers that depend on (seed, stream, index) and on nothing else.
//!
//! A node that draws gets the same numbers whatever the row bands, threads or order of work, because each
//! pixel has its own stream. The generator is SplitMix64 (Steele, Lea, Flood, OOPSLA 2014) started from a mix
//! of the seed and the stream's coordinates; transforms use the `libm` crate, so the bits are equal on every
//! machine.

/// A stream of random numbers.
#[derive(Clone, Debug)]
pub struct Random {
    state: u64,
}

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Random {
    /// The stream at some coordinates, such as `[x, y, purpose]`.
    pub fn new(seed: u64, stream: &[u64]) -> Random {
        let state = stream.iter().fold(mix(seed ^ 0x9e37_79b9_7f4a_7c15), |state, &s| {
            mix(state.rotate_left(23) ^ mix(s.wrapping_add(0x9e37_79b9_7f4a_7c15)))
        });
        Random { state }
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix(self.state)
    }

    /// Uniform in the open interval (0, 1).
    pub fn uniform(&mut self) -> f64 {
        ((self.bits() >> 12) as f64 + 0.5) / (1u64 << 52) as f64
    }

    /// Standard normal, by Box and Muller.
    pub fn normal(&mut self) -> f64 {
        let radius = libm::sqrt(-2.0 * libm::log(self.uniform()));
        radius * libm::cos(std::f64::consts::TAU * self.uniform())
    }

    /// Exponential with mean 1.
    pub fn exponential(&mut self) -> f64 {
        -libm::log(self.uniform())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_the_named_distributions() {
        let n = 200_000;
        let mut random = Random::new(7, &[1, 2]);
        let (mut normal, mut square, mut exponential) = (0.0, 0.0, 0.0);
        for _ in 0..n {
            let z = random.normal();
            normal += z;
            square += z * z;
            exponential += random.exponential();
        }
        // Five standard errors of each mean: 1, sqrt(2) and 1 over sqrt(n).
        let bound = 5.0 / (n as f64).sqrt();
        assert!((normal / n as f64).abs() < bound);
        assert!((square / n as f64 - 1.0).abs() < 1.42 * bound);
        assert!((exponential / n as f64 - 1.0).abs() < bound);
    }

    #[test]
    fn neighbouring_streams_differ() {
        assert_ne!(Random::new(7, &[1, 2]).bits(), Random::new(7, &[2, 1]).bits());
        assert_ne!(Random::new(7, &[1]).bits(), Random::new(8, &[1]).bits());
    }
}

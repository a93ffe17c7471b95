//! Light at the event pixels and in the frames, at nodes in time and between them.
//!
//! The scene's formula is evaluated every 32 us, a star's every 8; between nodes light is the cubic through
//! the four nearest ones.

use crate::optics::{self, MARGIN};
use crate::scene::{Grid, Scene};
use crate::sensor::Physics;

/// Seconds between two nodes, as a rule.
pub const NODE: f64 = 32e-6;

/// The weights of the nodes at -1, 0, 1, 2 for the cubic through them at `u` in 0 .. 1.
pub fn cubic(u: f64) -> [f64; 4] {
    let (a, b, c) = (u + 1.0, u - 1.0, u - 2.0);
    [-u * b * c / 6.0, a * b * c / 2.0, -a * u * c / 2.0, a * u * b / 6.0]
}

/// The weights for the integral of that cubic from `from` to `to` (0 .. 1), in units of the nodes' spacing.
pub fn cubic_integral(from: f64, to: f64) -> [f64; 4] {
    // Two points of Gauss and Legendre integrate a cubic exactly.
    let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
    let reach = half / libm::sqrt(3.0);
    let (left, right) = (cubic(middle - reach), cubic(middle + reach));
    std::array::from_fn(|k| half * (left[k] + right[k]))
}

/// What all pixels see at one instant.
#[derive(Clone, Debug)]
pub struct Node {
    /// Photocurrent of the frames' pixels.
    pub frames: Vec<f64>,
    /// Photocurrent of the event pixels, without what the front end adds.
    pub events: Vec<f64>,
    /// The voltage at which the front end would settle.
    pub settled: Vec<f64>,
}

/// Evaluates light at nodes.
pub struct Light<'a> {
    scene: &'a Scene,
    physics: &'a Physics,
    width: usize,
    height: usize,
    wide: Grid,
    blur: Option<[f64; MARGIN + 1]>,
    buffer: Vec<f64>,
    scratch: Vec<f64>,
}

impl<'a> Light<'a> {
    pub fn new(scene: &'a Scene, physics: &'a Physics, width: usize, height: usize) -> Self {
        let margin = if physics.blur + physics.crosstalk + physics.lateral > 0.0 { MARGIN } else { 0 };
        let reach = margin as f64;
        let wide = Grid {
            left: -reach - physics.shift[0],
            top: -reach - physics.shift[1],
            columns: width + 2 * margin,
            rows: height + 2 * margin,
        };
        let area = wide.columns * wide.rows;
        let blur = (physics.blur > 0.0).then(|| optics::gaussian(physics.blur));
        Self { scene, physics, width, height, wide, blur, buffer: vec![0.0; area], scratch: vec![0.0; area] }
    }

    /// An empty node of the right size.
    pub fn node(&self) -> Node {
        let n = self.width * self.height;
        Node { frames: vec![0.0; n], events: vec![0.0; n], settled: vec![0.0; n] }
    }

    /// Fills `node` with the light at time `t` (s).
    pub fn fill(&mut self, t: f64, node: &mut Node) {
        let (width, height) = (self.width as f64, self.height as f64);
        let plain = Grid { left: 0.0, top: 0.0, columns: self.width, rows: self.height };
        let own_path = self.wide.columns != self.width || self.physics.shift != [0.0; 2];
        if own_path {
            self.scene.log_light(t, &plain, width, height, &mut node.settled);
            node.frames.iter_mut().zip(&node.settled).for_each(|(i, l)| *i = libm::exp(*l));
            self.scene.log_light(t, &self.wide, width, height, &mut self.buffer);
            if self.physics.blur + self.physics.crosstalk > 0.0 {
                self.buffer.iter_mut().for_each(|v| *v = libm::exp(*v));
                if let Some(weights) = &self.blur {
                    optics::blur(&mut self.buffer, &self.wide, weights, &mut self.scratch);
                }
                if self.physics.crosstalk > 0.0 {
                    optics::share(&mut self.buffer, &self.wide, self.physics.crosstalk, &mut self.scratch);
                }
                self.buffer.iter_mut().for_each(|v| *v = libm::log(*v));
            }
            self.crop(&mut node.settled);
            node.events.iter_mut().zip(&node.settled).for_each(|(i, l)| *i = libm::exp(*l));
            if self.physics.lateral > 0.0 {
                optics::inhibit(&mut self.buffer, &self.wide, self.physics.lateral, &mut self.scratch);
                self.crop(&mut node.settled);
            }
        } else {
            self.scene.log_light(t, &plain, width, height, &mut node.settled);
            node.events.iter_mut().zip(&node.settled).for_each(|(i, l)| *i = libm::exp(*l));
            node.frames.copy_from_slice(&node.events);
        }
        if self.physics.dark > 0.0 {
            node.settled
                .iter_mut()
                .zip(&node.events)
                .for_each(|(l, i)| *l += libm::log1p(self.physics.dark / i));
        }
    }

    /// The array's part of the wide buffer.
    fn crop(&self, out: &mut [f64]) {
        let margin = (self.wide.columns - self.width) / 2;
        for (y, row) in out.chunks_exact_mut(self.width).enumerate() {
            row.copy_from_slice(&self.buffer[(y + margin) * self.wide.columns + margin..][..self.width]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cubic_through_four_nodes_and_its_integral_are_exact_for_cubics() {
        let f = |u: f64| 2.0 - u + 0.5 * u * u + 3.0 * u * u * u;
        let integral = |u: f64| 2.0 * u - u * u / 2.0 + u * u * u / 6.0 + 0.75 * u * u * u * u;
        let nodes = [f(-1.0), f(0.0), f(1.0), f(2.0)];
        let sum = |weights: [f64; 4]| weights.iter().zip(nodes).map(|(w, v)| w * v).sum::<f64>();
        assert!((sum(cubic(0.37)) - f(0.37)).abs() < 1e-12);
        assert!((sum(cubic_integral(0.2, 0.9)) - (integral(0.9) - integral(0.2))).abs() < 1e-12);
    }
}

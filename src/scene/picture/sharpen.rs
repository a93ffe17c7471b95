//! A picture with edges sharper than a fit on its grid resolves: the scene that a control is recorded of
//! begins with it.

use super::ScenePicture;

/// Coefficients of a sharpened picture for one of a fitted one, along an axis.
const SHARPER: usize = 3;

impl ScenePicture {
    /// The same scene with the sharpest edges that look alike at a distance: every place has the lowest or
    /// highest value within `reach` pixels, whichever is nearer to its own (toggle mapping: Kramer and
    /// Bruckner 1975), on a grid that holds them.
    #[must_use]
    pub fn sharpened(&self, reach: f64) -> ScenePicture {
        let grid = self.grid.finer(SHARPER);
        let ring: Vec<(f64, f64)> = (0..8)
            .map(|n| libm::sincos(std::f64::consts::TAU * f64::from(n) / 8.0))
            .map(|(y, x)| (reach * x, reach * y))
            .collect();
        let sharp = |surface: &[f32], n: usize| {
            let (x, y) = (
                grid.x0 + (n % grid.width) as f64 * grid.pitch,
                grid.y0 + (n / grid.width) as f64 * grid.pitch,
            );
            let own = self.grid.nearest(surface, x, y);
            let around = ring.iter().map(|by| self.grid.nearest(surface, x + by.0, y + by.1));
            let (low, high) =
                around.fold((own, own), |(low, high), value| (f64::min(low, value), f64::max(high, value)));
            (if own - low < high - own { low } else { high }) as f32
        };
        let layers: Vec<&[f32]> = self.surface.chunks_exact(self.grid.coefficients()).collect();
        let surface =
            layers.iter().flat_map(|surface| (0..grid.coefficients()).map(|n| sharp(surface, n))).collect();
        ScenePicture { grid, surface, coverage: Vec::new(), ..self.clone() }
    }
}

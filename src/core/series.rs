//! Series: instants and photocurrents of every pixel in flat columns, the common part of tracks and light.
//!
//! What happens between two instants is not said here: tracks hold ([`crate::tracks`]), light is linear
//! ([`crate::light`]). Pixels stand in row-major order, one flat list of samples with an offset per pixel, so
//! a row band is one contiguous piece. A pixel of three colours has three series side by side, as if the row
//! were three times as wide.

use crate::colour::Colour;
use crate::digest::{Digest, DigestBuilder};
use crate::error::DataError;
use crate::extent::Rows;
use crate::handle::{Band, BandMeta, InTime};
use crate::offsets::{gather, interleaved, interleaved_offsets, offsets_of, range_within};
use crate::time::TimeSpan;
use std::fmt;
use std::marker::PhantomData;
use std::ops::Range;

/// What is known of data that are kept as series.
pub trait SeriesMeta: BandMeta<Band = SeriesBand<Self>> + Clone + fmt::Debug + PartialEq {
    /// The name of the data type, `tracks`: it stands in the digests of rows, in messages and in the layout
    /// of the store.
    const NAME: &'static str;

    /// Grey, or the colours whose series stand next to each other.
    fn colour(&self) -> Colour;

    /// Does every sample carry a standard deviation?
    fn has_sigma(&self) -> bool {
        false
    }

    /// Series in a row: one for every pixel, or three, at `x * channels + channel`.
    fn row_series(&self) -> u32 {
        self.extent().width * self.colour().channels()
    }

    /// The same, with about how many samples there are.
    fn counted(&self, samples: u64) -> Self;
}

/// The series of some rows.
#[derive(Clone, Debug, PartialEq)]
pub struct SeriesBand<M> {
    start_row: u32,
    width: u32,
    offsets: Vec<usize>,
    /// Time of each sample, ns, rising inside a pixel.
    pub t: Vec<i64>,
    /// Photocurrent of each sample, in the units of the sensor description's gain.
    pub photocurrent: Vec<f32>,
    /// Standard deviation of the photocurrent's natural logarithm at each sample; empty when it is not known.
    pub sigma: Vec<f32>,
    kind: PhantomData<fn() -> M>,
}

/// One pixel's samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Series<'a> {
    /// Time of each sample, ns.
    pub t: &'a [i64],
    /// Photocurrent of each sample.
    pub photocurrent: &'a [f32],
    /// Standard deviation of the photocurrent's natural logarithm at each sample; empty when it is not known.
    pub sigma: &'a [f32],
}

/// `value`, finite, rounded to the nearest number of 16 bits (sign, exponent and 7 bits of bfloat16), ties to
/// even: to 0.4 %, which is more than standard deviations are good for, and half of what they take when they
/// are stored.
pub fn to_bfloat16(value: f32) -> f32 {
    let bits = value.to_bits();
    let half = 0x7FFF + ((bits >> 16) & 1);
    f32::from_bits(bits.wrapping_add(half) & 0xFFFF_0000)
}

impl<M: SeriesMeta> SeriesBand<M> {
    /// An empty band that pixels are pushed to, left to right and top to bottom.
    pub fn begin(start_row: u32, width: u32) -> SeriesBand<M> {
        SeriesBand {
            start_row,
            width,
            offsets: vec![0],
            t: Vec::new(),
            photocurrent: Vec::new(),
            sigma: Vec::new(),
            kind: PhantomData,
        }
    }

    /// Makes room for so many samples more.
    pub fn reserve(&mut self, samples: usize, with_sigma: bool) {
        self.t.reserve(samples);
        self.photocurrent.reserve(samples);
        self.sigma.reserve(if with_sigma { samples } else { 0 });
    }

    /// Adds the next pixel.
    pub fn push(&mut self, samples: impl IntoIterator<Item = (i64, f32)>) {
        for (t, photocurrent) in samples {
            self.t.push(t);
            self.photocurrent.push(photocurrent);
        }
        self.offsets.push(self.t.len());
    }

    /// Adds the next pixel, with standard deviations. Either all pixels have them or none.
    pub fn push_with_sigma(&mut self, samples: impl IntoIterator<Item = (i64, f32, f32)>) {
        for (t, photocurrent, sigma) in samples {
            self.t.push(t);
            self.photocurrent.push(photocurrent);
            self.sigma.push(sigma);
        }
        self.offsets.push(self.t.len());
    }

    /// Gives back what it has reserved beyond its pixels: up to as much again.
    #[must_use]
    pub fn shrunk(mut self) -> SeriesBand<M> {
        self.offsets.shrink_to_fit();
        self.t.shrink_to_fit();
        self.photocurrent.shrink_to_fit();
        self.sigma.shrink_to_fit();
        self
    }

    /// From columns in canonical order; `offsets` has one entry per pixel and a last one, `sigma` as many as
    /// `t` or none.
    ///
    /// # Errors
    /// When lengths disagree or offsets do not rise: the artefact is damaged.
    pub fn from_columns(
        start_row: u32,
        width: u32,
        offsets: Vec<usize>,
        t: Vec<i64>,
        photocurrent: Vec<f32>,
        sigma: Vec<f32>,
    ) -> Result<SeriesBand<M>, DataError> {
        let whole_rows =
            width > 0 && !offsets.is_empty() && (offsets.len() - 1).is_multiple_of(width as usize);
        let rising = offsets.first() == Some(&0)
            && offsets.last() == Some(&t.len())
            && offsets.windows(2).all(|w| w[0] <= w[1]);
        let fitting = t.len() == photocurrent.len() && (sigma.is_empty() || t.len() == sigma.len());
        if !whole_rows || !rising || !fitting {
            return Err(DataError::new(format!(
                "the columns of a band of {} do not fit each other",
                M::NAME
            )));
        }
        Ok(SeriesBand { start_row, width, offsets, t, photocurrent, sigma, kind: PhantomData })
    }

    /// Index of the first sample of each pixel, and the number of samples.
    pub fn offsets(&self) -> &[usize] {
        &self.offsets
    }

    /// The samples of pixel (x, row).
    pub fn pixel(&self, x: u32, row: u32) -> Series<'_> {
        let at = ((row - self.start_row) * self.width + x) as usize;
        let range = self.offsets[at]..self.offsets[at + 1];
        Series {
            t: &self.t[range.clone()],
            photocurrent: &self.photocurrent[range.clone()],
            sigma: self.sigma_of(range),
        }
    }

    fn sigma_of(&self, samples: std::ops::Range<usize>) -> &[f32] {
        if self.sigma.is_empty() { &[] } else { &self.sigma[samples] }
    }

    fn row_pixels(&self, rows: Rows) -> std::ops::Range<usize> {
        let width = self.width as usize;
        (rows.start - self.start_row) as usize * width..(rows.end - self.start_row) as usize * width
    }
}

impl<M: SeriesMeta> Band for SeriesBand<M> {
    type Meta = M;

    fn rows(&self) -> Rows {
        let rows = (self.offsets.len().saturating_sub(1) as u32).checked_div(self.width).unwrap_or(0);
        Rows { start: self.start_row, end: self.start_row + rows }
    }

    fn row_digest(&self, row: u32) -> Digest {
        let pixels = self.row_pixels(Rows { start: row, end: row + 1 });
        let counts: Vec<u64> =
            pixels.clone().map(|p| (self.offsets[p + 1] - self.offsets[p]) as u64).collect();
        let samples = self.offsets[pixels.start]..self.offsets[pixels.end];
        let mut digest = DigestBuilder::new(&format!("{}-row/1", M::NAME));
        digest.slice(&counts).slice(&self.t[samples.clone()]).slice(&self.photocurrent[samples.clone()]);
        // Nothing is added where there are none: such series are the content they were before others existed.
        if !self.sigma.is_empty() {
            digest.slice(self.sigma_of(samples));
        }
        digest.finish()
    }

    fn bytes(&self, rows: Rows) -> u64 {
        let pixels = self.row_pixels(rows);
        let samples = (self.offsets[pixels.end] - self.offsets[pixels.start]) as u64;
        8 * pixels.len() as u64 + samples * if self.sigma.is_empty() { 12 } else { 16 }
    }

    fn moved(self, start_row: u32) -> SeriesBand<M> {
        SeriesBand { start_row, ..self }
    }

    fn slice(&self, rows: Rows) -> SeriesBand<M> {
        let pixels = self.row_pixels(rows);
        let samples = self.offsets[pixels.start]..self.offsets[pixels.end];
        SeriesBand {
            start_row: rows.start,
            width: self.width,
            offsets: self.offsets[pixels.start..=pixels.end]
                .iter()
                .map(|offset| offset - samples.start)
                .collect(),
            t: self.t[samples.clone()].to_vec(),
            photocurrent: self.photocurrent[samples.clone()].to_vec(),
            sigma: self.sigma_of(samples).to_vec(),
            kind: PhantomData,
        }
    }

    fn concat(parts: Vec<SeriesBand<M>>) -> SeriesBand<M> {
        let all: usize = parts.iter().map(|part| part.t.len()).sum();
        let mut parts = parts.into_iter();
        let mut whole = parts.next().expect("at least one band to join");
        // Grown by doubling, it would take twice what it holds.
        let more = all - whole.t.len();
        whole.t.reserve_exact(more);
        whole.photocurrent.reserve_exact(more);
        if !whole.sigma.is_empty() {
            whole.sigma.reserve_exact(more);
        }
        for part in parts {
            let before = whole.t.len();
            whole.offsets.extend(part.offsets[1..].iter().map(|offset| offset + before));
            whole.t.extend(part.t);
            whole.photocurrent.extend(part.photocurrent);
            whole.sigma.extend(part.sigma);
        }
        whole
    }
}

impl<M: SeriesMeta> InTime for SeriesBand<M> {
    fn within(&self, window: TimeSpan) -> SeriesBand<M> {
        let of_pixel = |pixel: &[usize]| {
            let range = range_within(&self.t[pixel[0]..pixel[1]], window);
            pixel[0] + range.start..pixel[0] + range.end
        };
        let kept: Vec<Range<usize>> = self.offsets.windows(2).map(of_pixel).collect();
        let sigma = if self.sigma.is_empty() { Vec::new() } else { gather(&kept, &self.sigma) };
        SeriesBand {
            offsets: offsets_of(&kept),
            t: gather(&kept, &self.t),
            photocurrent: gather(&kept, &self.photocurrent),
            sigma,
            ..*self
        }
    }

    fn follow(parts: Vec<SeriesBand<M>>) -> SeriesBand<M> {
        fn all<M, T: Copy>(parts: &[SeriesBand<M>], column: impl Fn(&SeriesBand<M>) -> &[T]) -> Vec<T> {
            interleaved(&parts.iter().map(|part| (part.offsets.as_slice(), column(part))).collect::<Vec<_>>())
        }
        let first = parts.first().expect("at least one band to join");
        let has_sigma = parts.iter().any(|part| !part.sigma.is_empty());
        SeriesBand {
            offsets: interleaved_offsets(
                &parts.iter().map(|part| part.offsets.as_slice()).collect::<Vec<_>>(),
            ),
            t: all(&parts, |part| &part.t),
            photocurrent: all(&parts, |part| &part.photocurrent),
            sigma: if has_sigma { all(&parts, |part| &part.sigma) } else { Vec::new() },
            ..*first
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tracks::TrackBand;

    #[test]
    fn numbers_of_16_bits_are_the_nearest_ones() {
        for (value, nearest) in [
            (0.0, 0.0),
            (1.0, 1.0),
            (1.003, 1.0),
            (1.005, 1.007_812_5),
            (-3.01, -3.015_625),
            // Ties: to the even one.
            (1.0 + 1.0 / 256.0, 1.0),
            (1.0 + 3.0 / 256.0, 1.015_625),
        ] {
            assert_eq!(to_bfloat16(value), nearest, "{value}");
        }
        for n in 1..10_000 {
            let value = 1e-6 * 1.003_f32.powi(n);
            let error = (to_bfloat16(value) / value - 1.0).abs();
            assert!(error <= 1.0 / 256.0 && to_bfloat16(value).to_bits() & 0xFFFF == 0, "{value}");
        }
    }

    fn band() -> TrackBand {
        let mut band = TrackBand::begin(4, 3);
        for pixel in 0..12 {
            band.push((0..pixel % 4).map(|k| (k * 100, (pixel * 10 + k) as f32)));
        }
        band
    }

    #[test]
    fn standard_deviations_go_where_their_samples_go() {
        let mut known = TrackBand::begin(4, 3);
        for pixel in 0..12 {
            known.push_with_sigma(
                (0..pixel % 4).map(|k| (k * 100, (pixel * 10 + k) as f32, (pixel * 20 + k) as f32)),
            );
        }
        let parts = vec![known.slice(Rows { start: 4, end: 5 }), known.slice(Rows { start: 5, end: 8 })];
        assert_eq!(TrackBand::concat(parts), known);
        assert_eq!(known.slice(Rows { start: 6, end: 8 }).pixel(1, 6).sigma, [140.0, 141.0, 142.0]);
        assert_ne!(known.row_digest(5), band().row_digest(5));
        assert!(TrackBand::from_columns(0, 1, vec![0, 2], vec![0, 1], vec![0.0, 1.0], vec![0.0]).is_err());
    }

    #[test]
    fn cutting_and_joining_gives_the_same_band() {
        let band = band();
        assert_eq!(band.rows(), Rows { start: 4, end: 8 });
        for height in 1..5 {
            let parts: Vec<TrackBand> =
                band.rows().bands(height).into_iter().map(|rows| band.slice(rows)).collect();
            assert!(
                parts
                    .iter()
                    .all(|part| part.rows().iter().all(|row| part.row_digest(row) == band.row_digest(row)))
            );
            assert_eq!(TrackBand::concat(parts), band);
        }
    }

    #[test]
    fn a_pixel_finds_its_own_samples() {
        let band = band();
        assert_eq!(band.pixel(2, 6).t.len(), 8 % 4);
        assert_eq!(band.pixel(1, 6).photocurrent, [70.0, 71.0, 72.0]);
    }

    #[test]
    fn columns_that_do_not_fit_are_refused() {
        assert!(TrackBand::from_columns(0, 2, vec![0, 1, 3], vec![0, 1], vec![0.0, 1.0], vec![]).is_err());
        assert!(TrackBand::from_columns(0, 2, vec![0, 1], vec![0], vec![0.0], vec![]).is_err());
    }
}

//! Maps: named planes of one number per pixel, such as masks, thresholds and convergence.

use crate::digest::{Digest, DigestBuilder};
use crate::extent::{Extent, Rows};
use crate::handle::{Band, BandMeta, Handle};
use serde::{Deserialize, Serialize};

/// What is known about a set of planes before its data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapMeta {
    /// Size of each plane.
    pub extent: Extent,
    /// Name of each plane, in order; a unit in brackets where one applies: `cost`, `status`, `delay [us]`.
    pub planes: Vec<String>,
}

impl BandMeta for MapMeta {
    type Band = MapBand;

    fn extent(&self) -> Extent {
        self.extent
    }

    fn write_digest(&self, digest: &mut DigestBuilder) {
        digest.text("map/1").integer(self.extent.width.into()).integer(self.extent.height.into());
        for plane in &self.planes {
            digest.text(plane);
        }
    }
}

/// Planes of one number per pixel, read by row band.
pub type MapSet = Handle<MapMeta>;

/// Some rows of all planes.
#[derive(Clone, Debug, PartialEq)]
pub struct MapBand {
    rows: Rows,
    width: u32,
    /// Values as [row][plane][x].
    pub values: Vec<f32>,
    planes: usize,
}

impl MapBand {
    /// All zero.
    pub fn zeros(rows: Rows, meta: &MapMeta) -> MapBand {
        let planes = meta.planes.len();
        MapBand {
            rows,
            width: meta.extent.width,
            values: vec![0.0; rows.len() * planes * meta.extent.width as usize],
            planes,
        }
    }

    /// From values as [row][plane][x]; `None` when their number does not fit.
    pub fn from_values(rows: Rows, meta: &MapMeta, values: Vec<f32>) -> Option<MapBand> {
        let band = MapBand { rows, width: meta.extent.width, planes: meta.planes.len(), values };
        (band.values.len() == rows.len() * band.row_values()).then_some(band)
    }

    fn row_values(&self) -> usize {
        self.planes * self.width as usize
    }

    /// One row of one plane.
    pub fn row(&self, plane: usize, row: u32) -> &[f32] {
        let at = (row - self.rows.start) as usize * self.row_values() + plane * self.width as usize;
        &self.values[at..at + self.width as usize]
    }

    /// One row of one plane, to write.
    pub fn row_mut(&mut self, plane: usize, row: u32) -> &mut [f32] {
        let at = (row - self.rows.start) as usize * self.row_values() + plane * self.width as usize;
        &mut self.values[at..at + self.width as usize]
    }
}

impl Band for MapBand {
    type Meta = MapMeta;

    fn rows(&self) -> Rows {
        self.rows
    }

    fn row_digest(&self, row: u32) -> Digest {
        let at = (row - self.rows.start) as usize * self.row_values();
        DigestBuilder::new("map-row/1").slice(&self.values[at..at + self.row_values()]).finish()
    }

    fn bytes(&self, rows: Rows) -> u64 {
        (rows.len() * self.row_values() * size_of::<f32>()) as u64
    }

    fn moved(self, start_row: u32) -> MapBand {
        let rows = Rows { start: start_row, end: start_row + self.rows.len() as u32 };
        MapBand { rows, ..self }
    }

    fn slice(&self, rows: Rows) -> MapBand {
        let range = (rows.start - self.rows.start) as usize * self.row_values()
            ..(rows.end - self.rows.start) as usize * self.row_values();
        MapBand { rows, values: self.values[range].to_vec(), ..*self }
    }

    fn concat(parts: Vec<MapBand>) -> MapBand {
        let mut parts = parts.into_iter();
        let mut whole = parts.next().expect("at least one band to join");
        for part in parts {
            whole.rows.end = part.rows.end;
            whole.values.extend(part.values);
        }
        whole
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_and_rows_do_not_mix() {
        let meta = MapMeta { extent: Extent { width: 2, height: 4 }, planes: vec!["a".into(), "b".into()] };
        let mut band = MapBand::zeros(meta.extent.rows(), &meta);
        band.row_mut(1, 2).copy_from_slice(&[5.0, 6.0]);
        assert_eq!(band.row(0, 2), [0.0, 0.0]);
        let part = band.slice(Rows { start: 2, end: 3 });
        assert_eq!(part.row(1, 2), [5.0, 6.0]);
        assert_eq!(part.row_digest(2), band.row_digest(2));
        let joined = MapBand::concat(band.rows().bands(1).into_iter().map(|rows| band.slice(rows)).collect());
        assert_eq!(joined, band);
    }
}

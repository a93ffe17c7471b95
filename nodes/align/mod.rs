//! Aligns two cameras: events and frames on the pixels of either.

pub mod light;
pub mod recording;
pub mod tracks;

#[cfg(test)]
mod testing {
    use photocurrent_core::{Extent, MapBand, MapSet};
    use photocurrent_scene::alignment::Alignment;
    use std::sync::Arc;

    /// Places that lie right of and below the pixels by so much.
    pub(super) fn shifted(by: f64) -> impl Fn(u32, u32) -> (f64, f64) {
        move |column, row| (f64::from(column) + by, f64::from(row) + by)
    }

    /// The map of places of an event array.
    pub(super) fn alignment(extent: Extent, place: &dyn Fn(u32, u32) -> (f64, f64)) -> MapSet {
        let meta = Alignment::meta(extent);
        let mut band = MapBand::zeros(extent.rows(), &meta);
        for row in 0..extent.height {
            for column in 0..extent.width {
                let (x, y) = place(column, row);
                band.row_mut(0, row)[column as usize] = x as f32;
                band.row_mut(1, row)[column as usize] = y as f32;
            }
        }
        MapSet::in_memory(Arc::new(meta), band)
    }
}

//! Tracks and light: one layout for both, flat columns with an offset per pixel, in a group named like the
//! type; `sigma` stands next to `photocurrent` where it is known.

use super::columns::{DAMAGED, between, column, create_group, each_band, relative, required};
use crate::error::StoreError;
use crate::hdf::Opened;
use crate::hdf::grid::Grid;
use crate::hdf::write::ColumnWriter;
use crate::threads;
use photocurrent_core::handle::{BandSource, Handle};
use photocurrent_core::series::{SeriesBand, SeriesMeta};
use photocurrent_core::value::ValueDigest;
use photocurrent_core::{DataError, Rows};
use std::sync::Arc;

/// Tracks or light being written.
pub(super) struct SeriesBody {
    t: ColumnWriter<i64>,
    photocurrent: ColumnWriter<f32>,
    sigma: Option<ColumnWriter<f32>>,
    pixel_offsets: ColumnWriter<u64>,
}

impl SeriesBody {
    pub(super) fn create<M: SeriesMeta>(opened: &Opened, meta: &M) -> Result<SeriesBody, StoreError> {
        create_group(opened, M::NAME)?;
        let name = |column: &str| format!("{}/{column}", M::NAME);
        let mut pixel_offsets = ColumnWriter::new(opened, &name("pixel_offsets"));
        pixel_offsets.append(&[0])?;
        let (t, photocurrent) =
            (ColumnWriter::new(opened, &name("t")), ColumnWriter::new(opened, &name("photocurrent")));
        let sigma = meta.has_sigma().then(|| ColumnWriter::new(opened, &name("sigma")));
        Ok(SeriesBody { t, photocurrent, sigma, pixel_offsets })
    }

    pub(super) fn append<M: SeriesMeta>(
        &mut self,
        part: &Handle<M>,
        digest: Option<&mut ValueDigest>,
    ) -> Result<(), StoreError> {
        each_band(part, digest, |band| {
            let before = self.t.len() as u64;
            let offsets: Vec<u64> =
                band.offsets()[1..].iter().map(|&offset| before + offset as u64).collect();
            self.pixel_offsets.append(&offsets)?;
            self.t.append(&band.t)?;
            if let Some(sigma) = &mut self.sigma {
                sigma.append(&band.sigma)?;
            }
            self.photocurrent.append(&band.photocurrent)
        })
    }

    pub(super) fn finish(self, opened: &Opened) -> Result<(), StoreError> {
        opened.set_text_attribute(self.t.finish()?.dataset(), "unit", "ns")?;
        self.photocurrent.finish()?;
        if let Some(sigma) = self.sigma {
            sigma.finish()?;
        }
        self.pixel_offsets.finish()?;
        Ok(())
    }
}

struct SeriesSource {
    opened: Opened,
    width: usize,
    t: Grid<i64>,
    photocurrent: Grid<f32>,
    sigma: Option<Grid<f32>>,
    pixel_offsets: Grid<u64>,
}

impl SeriesSource {
    fn band<M: SeriesMeta>(&self, rows: Rows) -> Result<SeriesBand<M>, StoreError> {
        let pixels = rows.start as usize * self.width;
        let offsets = self.pixel_offsets.column(pixels..pixels + rows.len() * self.width + 1)?;
        let (first, offsets) =
            relative(&self.opened, &format!("/{}/pixel_offsets", M::NAME), offsets, self.t.shape[0])?;
        let range = first..first + offsets.last().copied().unwrap_or(0);
        let (t, photocurrent) =
            threads::both(|| self.t.column(range.clone()), || self.photocurrent.column(range.clone()));
        let sigma =
            self.sigma.as_ref().map(|sigma| sigma.column(range.clone())).transpose()?.unwrap_or_default();
        SeriesBand::from_columns(rows.start, self.width as u32, offsets, t?, photocurrent?, sigma).map_err(
            |error| {
                self.opened.content(&format!("/{}", M::NAME), error.message, "whole rows of pixels", DAMAGED)
            },
        )
    }
}

impl<M: SeriesMeta> BandSource<SeriesBand<M>> for SeriesSource {
    fn read(&self, rows: Rows) -> Result<SeriesBand<M>, DataError> {
        Ok(self.band(rows)?)
    }

    fn bytes(&self, rows: Rows) -> Option<u64> {
        let (from, to) = (rows.start as usize * self.width, rows.end as usize * self.width);
        let each = if self.sigma.is_some() { 16 } else { 12 };
        Some(8 * (to - from) as u64 + between(&self.pixel_offsets, from, to)? * each)
    }
}

pub(super) fn open<M: SeriesMeta>(opened: &Opened, meta: &M) -> Result<Handle<M>, StoreError> {
    let name = |column: &str| format!("{}/{column}", M::NAME);
    let t: Grid<i64> = required(opened, &name("t"))?;
    let n = t.shape.first().copied().unwrap_or(0);
    let source = SeriesSource {
        opened: opened.clone(),
        width: meta.row_series() as usize,
        t: column(opened, &name("t"), n)?,
        photocurrent: column(opened, &name("photocurrent"), n)?,
        sigma: meta.has_sigma().then(|| column(opened, &name("sigma"), n)).transpose()?,
        pixel_offsets: column(
            opened,
            &name("pixel_offsets"),
            meta.row_series() as usize * meta.extent().height as usize + 1,
        )?,
    };
    Ok(Handle::new(Arc::new(meta.counted(n as u64)), meta.extent().rows(), Arc::new(source)))
}

//! One picture of the scene with the evaluated parts marked: pixels of held-out frames, pixels that tests
//! name, rows and columns of effects.

use super::located::grey;
use super::svg::open_svg;
use crate::diagnose::Diagnosis;
use crate::report::Report;
use crate::sample::PixelSample;
use photocurrent_page::escaped;
use photocurrent_scene::case::Case;
use std::fmt::Write;

/// More marks of single pixels hide the picture.
const MOST_MARKS: usize = 400;
const TOP: f64 = 4.0;

/// The picture, and a caption of the marks.
pub(super) fn overview(html: &mut String, case: &Case, report: &Report, found: Option<&Diagnosis>) {
    let (width, height) = (case.extent.width as usize, case.extent.height as usize);
    let size = f64::min(640.0 / width as f64, 480.0 / height as f64);
    let (wide, high) = (size * width as f64, size * height as f64);
    let mut svg =
        open_svg("The scene with evaluated parts and parts that tests name", wide + 4.0, TOP + high + 4.0);
    let _ =
        write!(svg, "<rect x=\"0\" y=\"{TOP}\" width=\"{wide:.1}\" height=\"{high:.1}\" fill=\"#e6e8eb\"/>");
    grey(&mut svg, case, size, TOP);
    let mut marks: Vec<String> = vec![if case.frames.is_some() {
        "The frame in the middle of the recording".into()
    } else {
        "The recording has no frames, so there is no picture of the scene".into()
    }];
    if let Some(sample) = found.and_then(|found| found.sample.as_ref()) {
        blocks(&mut svg, sample, width, size);
        marks.push("yellow frames: pixels whose held-out frames are predicted".into());
    }
    let unmarked = marks.len();
    for finding in found.map_or(&[][..], |found| &found.integrity.findings) {
        if finding.pixels.is_empty() {
            continue;
        }
        circles(&mut svg, &finding.pixels, width, size);
        let cut = if finding.pixels.len() > MOST_MARKS {
            format!(" ({MOST_MARKS} of them are marked)")
        } else {
            String::new()
        };
        marks.push(format!("orange circles: {} pixels of {}{cut}", finding.pixels.len(), finding.id));
    }
    for effect in &report.effects {
        let ([top, bottom], [left, right]) = (
            effect.location.rows.map(|row| row as usize),
            effect.location.columns.map(|column| column as usize),
        );
        if (top, left, bottom + 1, right + 1) == (0, 0, height, width) || bottom >= height || right >= width {
            continue;
        }
        dashed(&mut svg, [left, top, right, bottom], size);
        marks.push(format!(
            "dashed frame: rows {top} to {bottom}, columns {left} to {right}, where {} shows",
            effect.id
        ));
    }
    if marks.len() == unmarked {
        marks.push("no test names single pixels, rows or columns".into());
    }
    let masked = found.map_or(0, |found| found.integrity.masked.len());
    if masked > 0 {
        marks.push(format!("{masked} pixels were left out of everything that needs a scene"));
    }
    let events = case.events.len();
    let frames = case.frames.as_ref().map_or(0, |frames| frames.times.len());
    let seconds = (case.span.1 - case.span.0) as f64 * 1e-9;
    let _ = writeln!(
        html,
        "<figure>{svg}</svg>\n<figcaption>{}.</figcaption></figure>",
        escaped(&marks.join("; "))
    );
    let _ = writeln!(
        html,
        "<p>{width} x {height} pixels, {events} events and {frames} frames in {}.</p>",
        escaped(&crate::units::readable(seconds, "s"))
    );
}

/// Frames around the blocks of a sample: all pixels of a block are one rectangle.
fn blocks(svg: &mut String, sample: &PixelSample, width: usize, size: f64) {
    let mut blocks: Vec<[usize; 4]> = vec![[usize::MAX, usize::MAX, 0, 0]; sample.block_count];
    for (&pixel, &block) in sample.pixels.iter().zip(&sample.block) {
        let (x, y, of) = (pixel as usize % width, pixel as usize / width, &mut blocks[block as usize]);
        *of = [of[0].min(x), of[1].min(y), of[2].max(x + 1), of[3].max(y + 1)];
    }
    for [left, top, right, bottom] in blocks.into_iter().filter(|block| block[2] > 0) {
        let _ = write!(
            svg,
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"none\" \
                 stroke=\"#ffd84d\" stroke-width=\"1.5\"/>",
            size * left as f64,
            TOP + size * top as f64,
            size * (right - left) as f64,
            size * (bottom - top) as f64
        );
    }
}

/// Circles around pixels, the first ones of many.
fn circles(svg: &mut String, pixels: &[u32], width: usize, size: f64) {
    let place =
        |pixel: u32| (size * (pixel as usize % width) as f64, TOP + size * (pixel as usize / width) as f64);
    for &pixel in pixels.iter().take(MOST_MARKS) {
        let ((x, y), reach) = (place(pixel), f64::max(size, 5.0));
        let (x, y) = (x + 0.5 * size, y + 0.5 * size);
        let _ = write!(
            svg,
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{reach:.1}\" fill=\"none\" \
                                 stroke=\"#000\" stroke-width=\"3\"/>"
        );
        let _ = write!(
            svg,
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{reach:.1}\" fill=\"none\" \
                                 stroke=\"#ff9a3c\" stroke-width=\"1.5\"/>"
        );
    }
}

/// A dashed frame around columns and rows, first and last: left, top, right, bottom.
fn dashed(svg: &mut String, [left, top, right, bottom]: [usize; 4], size: f64) {
    let at = (
        size * left as f64,
        TOP + size * top as f64,
        size * (right + 1 - left) as f64,
        size * (bottom + 1 - top) as f64,
    );
    for (colour, dashes) in [("#000", "none"), ("#fff", "6 4")] {
        let _ = write!(
            svg,
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"none\" \
                 stroke=\"{colour}\" stroke-width=\"2\" stroke-dasharray=\"{dashes}\"/>",
            at.0, at.1, at.2, at.3
        );
    }
}

//! Tests of `write/contact_sheet`: which frame is shown, its greys, and what is refused.

use super::super::picture::load;
use super::super::testing::exporting;
use super::*;
use photocurrent_core::{Exposure, FrameBlock, FrameScale, testing};
use std::collections::BTreeMap;
use std::path::Path;

const EXTENT: Extent = Extent { width: 48, height: 32 };

/// A bright disc that moves to the right; `gain` is the method's mistake.
fn disc(count: i64, gain: f32) -> FrameSequence {
    let exposures = (0..count).map(|l| Exposure::new(l * 1_000_000, l * 1_000_000 + 200_000)).collect();
    testing::captured(EXTENT, exposures, 0, |l, x, y| {
        let centre = 8.0 + 32.0 * l as f32 / count as f32;
        let distance = ((x as f32 - centre).powi(2) + (y as f32 - 16.0).powi(2)).sqrt();
        gain * (100.0 + 700.0 / (1.0 + libm::expf(distance - 6.0)) + 2.0 * y as f32)
    })
}

fn params(labels: &[&str]) -> Params {
    Params { labels: labels.iter().map(|label| label.to_string()).collect(), ..Params::default() }
}

fn draw_sheet(params: Params, frames: Vec<FrameSequence>, truth: Option<Truth>, look: impl FnOnce(Table, Vec<String>, &Path)) {
    let node = WriteContactSheet::build(params).unwrap();
    exporting(|cx| node.run(In { frames, truth }, cx).unwrap(), |out, notes, folder| look((*out.listing).clone(), notes, folder));
}

#[test]
fn the_nearest_exposure_middle_is_shown_and_listed() {
    // Middles at 0.1, 1.1, 2.1 ... ms; every fifth frame of the second sequence.
    let (all, some) = (disc(11, 1.0), disc(11, 0.6).select(vec![0, 5, 10]));
    draw_sheet(Params { columns: 3, ..params(&["all", "some"]) }, vec![all, some], None, |listing, notes, folder| {
        assert_eq!(listing.column("t_ns"), Some(&Column::Integers(vec![100_000, 5_100_000, 10_100_000, 100_000, 5_100_000, 10_100_000])));
        assert_eq!(listing.column("frame"), Some(&Column::Integers(vec![0, 5, 10, 0, 1, 2])));
        assert_eq!(listing.column("label").unwrap().cell(3), "some");
        assert!(notes[0].starts_with("contact_sheet.png is for looking only"), "{notes:?}");
        let (_, info) = load(&folder.join("contact_sheet.png"));
        // Three columns of 48 pixels fill 1600 dots at 11 dots a pixel.
        assert_eq!((info.width, info.color_type), (6 + 3 * (48 * 11 + 6), png::ColorType::Grayscale));
        assert!(info.uncompressed_latin1_text[0].text.contains("gamma 2.2"));
    });
}

#[test]
fn all_rows_share_the_range_of_the_first_and_gamma_brightens_the_middle() {
    let flat = |dn: f32| testing::captured(Extent { width: 2, height: 1 }, vec![Exposure::new(0, 10)], 0, move |_, x, _| if x == 0 { 0.0 } else { dn });
    let params = Params { columns: 1, scale: Some(1), ..params(&["half", "twice"]) };
    draw_sheet(params, vec![flat(50.0), flat(200.0)], Some(Truth(flat(100.0))), |listing, _, folder| {
        assert_eq!(listing.column("label").unwrap().cell(0), "truth");
        let (values, info) = load(&folder.join("contact_sheet.png"));
        let layout = Layout::new(Crop { x: 0, y: 0, width: 2, height: 1 }, Some(1), 1, 3, font::width("0.000 ms"));
        assert_eq!((u64::from(info.width), u64::from(info.height)), (layout.width(), layout.height()));
        let row = |r: usize| {
            let at = (layout.picture_y(r) * info.width + layout.x(0)) as usize;
            values[at..at + 2].to_vec()
        };
        // 255 x 0.5^(1 / 2.2) = 186.08.
        assert_eq!([row(0), row(1), row(2)], [vec![0, 255], vec![0, 186], vec![0, 255]]);
    });
}

#[test]
fn a_crop_shows_the_part_that_was_asked_for() {
    let coordinates = testing::captured(EXTENT, vec![Exposure::new(0, 10)], 0, |_, x, y| (100 * y + x) as f32);
    let shown = read_cropped(&coordinates, 0, Crop { x: 3, y: 2, width: 2, height: 2 }).unwrap();
    assert_eq!(shown.dn, [203.0, 204.0, 303.0, 304.0]);
}

#[test]
fn colour_next_to_grey_gives_a_colour_sheet() {
    let grey = testing::captured(Extent { width: 2, height: 2 }, vec![Exposure::new(0, 10)], 0, |_, x, _| x as f32);
    let meta = FramesMeta { channels: 3, scale: FrameScale::Captured, ..(*grey.meta).clone() };
    let block = FrameBlock { frames: 0..1, rows: meta.extent.rows(), row_values: 6, dn: [1.0, 0.0, 0.0].repeat(4) };
    let red = FrameSequence::in_memory(Arc::new(meta), block);
    draw_sheet(Params { columns: 1, scale: Some(1), ..params(&["grey", "red"]) }, vec![grey, red], None, |_, _, folder| {
        let (values, info) = load(&folder.join("contact_sheet.png"));
        assert_eq!(info.color_type, png::ColorType::Rgb);
        assert!(values.chunks(3).any(|dot| dot == [255, 0, 0]));
    });
}

#[test]
fn rows_whose_numbers_stand_for_different_exposures_are_told() {
    let of = |length: i64| testing::captured(EXTENT, vec![Exposure::new(0, length)], 0, |_, x, _| x as f32);
    draw_sheet(Params { columns: 1, ..params(&["a", "b"]) }, vec![of(10), of(20)], None, |_, notes, _| {
        assert_eq!(notes[0], "brightness differs by exposure: \"a\" has DN of 10 ns, \"b\" of 20 ns");
    });
}

#[test]
fn instants_are_stated_or_spaced_over_the_common_time() {
    let (long, short) = (disc(11, 1.0), disc(11, 1.0).select((3..8).collect()));
    let instants = |params: Params| WriteContactSheet::build(params).unwrap().instants(&[&long.meta, &short.meta]);
    assert_eq!(instants(Params { columns: 3, ..Params::default() }), [3_100_000, 5_100_000, 7_100_000]);
    assert_eq!(instants(Params { columns: 1, start: Some(Duration::new(10)), end: Some(Duration::new(20)), ..Params::default() }), [15]);
    assert_eq!(instants(Params { times: Some(vec![Duration::new(7)]), ..Params::default() }), [7]);
    assert_eq!(nearest(&long.meta.times, i64::MAX), 10);
}

#[test]
fn what_cannot_be_drawn_is_refused_before_any_data() {
    let meta = |frames: &FrameSequence| Meta::Frames(frames.meta.clone());
    let plan = |params: Params, metas: Vec<Meta>| WriteContactSheet::build(params)?.plan(&PortMetas::new(BTreeMap::from([("frames".to_string(), metas)])));
    let (disc, other) = (disc(2, 1.0), testing::frames(5, 5, 2));
    assert!(plan(params(&["a"]), vec![meta(&disc)]).is_ok());
    let refused = |params: Params, metas: Vec<Meta>| plan(params, metas).unwrap_err().message;
    assert_eq!(refused(params(&["a", "b"]), vec![meta(&disc)]), "`labels` has 2 texts, and 1 input is connected to `frames`");
    assert_eq!(refused(params(&["a", "b"]), vec![meta(&disc), meta(&other)]), "\"b\" has 5 x 5 pixels, and \"a\" has 48 x 32");
    let crop = Some(Crop { x: 40, y: 0, width: 9, height: 1 });
    assert_eq!(refused(Params { crop, ..params(&["a"]) }, vec![meta(&disc)]), "`crop` asks for 9 x 1 pixels at (40, 0), and the frames have 48 x 32");
    let huge = Params { columns: 100, scale: Some(64), ..params(&["a", "b", "c", "d"]) };
    assert!(refused(huge, vec![meta(&disc); 4]).contains("the contact sheet would have"));
    assert!(refused(Params { columns: 0, ..params(&["a"]) }, vec![]).contains("1 to 100"));
}

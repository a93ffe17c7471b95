//! The filter against its authors' pictures, the truth of the clip, and cases that can be worked out by hand.

use super::super::reference;
use super::events::PixelList;
use super::sequence::Span;
use super::*;
use photocurrent_core::events::{Event, Polarity};
use photocurrent_core::{Extent, testing};

fn settings(variant: Variant, sequence: Sequence) -> Settings {
    Settings { variant, sequence, ..Settings::new(&Params::default()) }
}

/// Pictures of the reference clip: those at 300 Hz, and those at the frames' times.
struct Pictures {
    high_rate: Vec<Vec<f64>>,
    at_frames: Vec<(usize, Vec<f64>)>,
}

fn clip(variant: Variant) -> Pictures {
    let settings = settings(variant, Sequence::AsReleased);
    let lists =
        PixelLists::from_lists(reference::events().into_iter().map(|list| {
            list.into_iter().map(|(us, sign)| (us * 1000, sign * reference::CONTRAST)).collect()
        }));
    let frames = reference::frames();
    let block = frames.read_rows(frames.rows()).unwrap();
    // The authors' period is a whole number of microseconds.
    let instants: Vec<i64> = (0..43).map(|m| 70_000_000 + m * 3_333_000).collect();
    let course = sequence::course(
        &frames.meta.times.exposures,
        &lists.order(),
        &instants,
        settings.variant,
        settings.sequence,
        1e9,
    );
    let shared = Shared { settings: &settings, course: &course, events: &lists, width: 48, height: 32 };
    let mut pictures =
        Pictures { high_rate: vec![vec![f64::NAN; reference::PIXELS]; 43], at_frames: Vec::new() };
    for pixel in 0..reference::PIXELS {
        let values: Vec<f64> = (0..8).map(|l| f64::from(block.frame(l)[pixel]) / 255.0).collect();
        pixel::run(&shared, pixel as u32, &values, |which, value| match which {
            Picture::Asked(n) => pictures.high_rate[n][pixel] = value,
            Picture::Frame(frame) => {
                if pixel == 0 {
                    pictures.at_frames.push((frame, vec![f64::NAN; reference::PIXELS]));
                }
                let (_, picture) = pictures
                    .at_frames
                    .iter_mut()
                    .find(|(l, _)| *l == frame)
                    .expect("pixel 0 has every picture");
                picture[pixel] = value;
            }
        });
    }
    pictures
}

fn psnr_db(picture: &[f64], truth: &[f64]) -> f64 {
    let mse = picture.iter().zip(truth).map(|(a, b)| (a - b) * (a - b)).sum::<f64>() / truth.len() as f64;
    -10.0 * libm::log10(mse)
}

#[test]
fn as_released_is_what_the_authors_program_gives() {
    let found = clip(Variant::AsReleased);
    let expected = reference::pictures("akf_high_rate.f64");
    // Those that are kept: the first, one after a change of frames, one at the end of an exposure, the last.
    let kept: Vec<usize> = if expected.len() == 43 { (0..43).collect() } else { vec![0, 6, 24, 42] };
    for (n, authors) in kept.iter().zip(&expected) {
        let apart = reference::apart(&found.high_rate[*n], authors);
        assert!(apart < 1e-9, "picture {n}: {apart:e}");
    }
    let expected = reference::pictures("akf_frames.f64");
    assert_eq!(found.at_frames.iter().map(|(frame, _)| *frame).collect::<Vec<_>>(), [2, 3, 4]);
    for ((frame, picture), authors) in found.at_frames.iter().zip(&expected) {
        let apart = reference::apart(picture, authors);
        assert!(apart < 1e-9, "frame {frame}: {apart:e}");
    }
}

#[test]
fn corrected_is_nearer_to_the_truth_than_released() {
    let truth = reference::pictures("clip_truth.f64");
    let decibels = |variant| -> Vec<f64> {
        clip(variant)
            .at_frames
            .iter()
            .zip(&truth)
            .map(|((_, picture), truth)| psnr_db(picture, truth))
            .collect()
    };
    let (released, corrected) = (decibels(Variant::AsReleased), decibels(Variant::Corrected));
    assert!(released.iter().all(|db| (26.2..26.8).contains(db)), "{released:?}");
    assert!(corrected.iter().all(|db| (28.7..29.8).contains(db)), "{corrected:?}");
}

#[test]
fn the_whole_sequence_covers_every_instant_and_is_as_good() {
    let truth = reference::pictures("clip_truth.f64");
    let at = testing::captured(
        reference::EXTENT,
        (0..8).map(|l| Exposure::new(10_000_000 + l * 40_000_000, 30_000_000 + l * 40_000_000)).collect(),
        0,
        |_, _, _| 0.0,
    );
    let params = Params { threshold: Some(reference::CONTRAST), white: Some(255.0), ..Params::default() };
    let input = In {
        events: reference::stream(),
        frames: reference::frames(),
        sensor: None,
        contrast: None,
        at: Some(at),
    };
    let (out, notes) = testing::with_context(reference::EXTENT.rows(), &["frames"], |cx| {
        BaselineAkf { params }.run(input, cx)
    });
    let frames = out.unwrap().frames;
    let block = frames.read_rows(frames.rows()).unwrap();
    assert!(block.dn.iter().all(|dn| dn.is_finite()) && notes.is_empty(), "{notes:?}");
    for l in 2..5 {
        let picture: Vec<f64> = block.frame(l).iter().map(|dn| f64::from(*dn) / 255.0).collect();
        let db = psnr_db(&picture, &truth[l - 2]);
        assert!(db > 28.5, "frame {l}: {db}");
    }
}

#[test]
fn the_released_sequence_says_what_it_leaves_out() {
    let sampling = Sampling { rate: Rate::new(100.0), ..Sampling::default() };
    let params = Params {
        sampling,
        threshold: Some(reference::CONTRAST),
        white: Some(255.0),
        sequence: Sequence::AsReleased,
        ..Params::default()
    };
    let input = In {
        events: reference::stream(),
        frames: reference::frames(),
        sensor: None,
        contrast: None,
        at: None,
    };
    let (out, notes) = testing::with_context(reference::EXTENT.rows(), &["frames"], |cx| {
        BaselineAkf { params }.run(input, cx)
    });
    let frames = out.unwrap().frames;
    let known: Vec<i64> = (0..frames.len())
        .filter(|l| frames.read(*l..l + 1, frames.rows()).unwrap().dn.iter().all(|dn| dn.is_finite()))
        .map(|l| frames.meta.times.exposures[l].mid().0 / 1_000_000)
        .collect();
    assert_eq!((known.first(), known.last()), (Some(&70), Some(&200)));
    assert!(notes[0].ends_with("outside the authors' sequence and are not known (NaN)"), "{notes:?}");
}

#[test]
fn the_exact_mean_of_a_doubling_halfway_is_one_and_a_half() {
    let (t, step) = ([5_000_000], [libm::log(2.0)]);
    let list = PixelList { pixel: 0, t: &t, step: &step };
    let span = Span { t: [0, 5_000_000, 10_000_000], key: [(0, 0); 3] };
    let (log_mean, end) = pixel::exact_mean(list, &span);
    assert!((log_mean - libm::log(1.5)).abs() < 1e-15 && (end - libm::log(2.0)).abs() < 1e-15);
}

#[test]
fn a_still_pixel_keeps_its_frame() {
    let extent = Extent { width: 3, height: 3 };
    let exposures = (0..3).map(|l| Exposure::new(l * 10_000_000, l * 10_000_000 + 4_000_000)).collect();
    let frames = testing::captured(extent, exposures, 0, |_, _, _| 100.0);
    let events =
        testing::stream(extent, vec![Event { x: 0, y: 0, polarity: Polarity::On, t: 5_000_000, t_in: None }]);
    let params = Params { threshold: Some(0.1), white: Some(200.0), ..Params::default() };
    let (out, _) = testing::with_context(extent.rows(), &["frames"], |cx| {
        BaselineAkf { params }.run(In { events, frames, sensor: None, contrast: None, at: None }, cx)
    });
    let frames = out.unwrap().frames;
    let block = frames.read_rows(extent.rows()).unwrap();
    assert!((0..frames.len()).all(|l| (block.row(l, 2)[2] - 100.0).abs() < 1e-4));
}

#[test]
fn a_searched_threshold_is_one_that_could_have_been_stated() {
    use photocurrent_core::table::Column;
    use photocurrent_core::{Sensor, Table};
    use std::sync::Arc;
    let dn = |threshold: Option<f64>, searched: Option<f64>| {
        // The description's thresholds would be others.
        let mut sensor = Sensor::unknown("test");
        (sensor.comparator.threshold_on, sensor.comparator.threshold_off) = (Some(0.4), Some(0.4));
        let contrast =
            searched.map(|value| Arc::new(Table::default().with("contrast", Column::Numbers(vec![value]))));
        let params = Params { threshold, white: Some(255.0), ..Params::default() };
        let input = In {
            events: reference::stream(),
            frames: reference::frames(),
            sensor: Some(Arc::new(sensor)),
            contrast,
            at: Some(reference::frames()),
        };
        let (out, _) = testing::with_context(reference::EXTENT.rows(), &["frames"], |cx| {
            BaselineAkf { params }.run(input, cx)
        });
        out.unwrap().frames.read_rows(reference::EXTENT.rows()).unwrap().dn
    };
    let stated = dn(Some(0.05), None);
    assert_eq!(dn(None, Some(0.05)), stated);
    assert_eq!(dn(Some(0.05), Some(0.3)), stated, "what is stated wins");
    assert_ne!(dn(None, None), stated);
}

#[test]
fn too_few_frames_for_the_released_sequence_are_refused() {
    let frames = testing::frames(2, 2, 4);
    let request = Request { frames: &frames.meta, events: None, at: None, sensor: None };
    let node = BaselineAkf {
        params: Params {
            threshold: Some(0.1),
            white: Some(255.0),
            sequence: Sequence::AsReleased,
            ..Params::default()
        },
    };
    assert_eq!(node.prepare(&request, None).err().and_then(|error| error.param).as_deref(), Some("sequence"));
}

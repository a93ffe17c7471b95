//! Claims about the node, on small recordings whose light is known.

use super::*;
use crate::refine::fixtures::{
    EXTENT, decibels, error, every_pixel_for_itself, record, sensor, solve, texture,
};
use photocurrent_core::{EventStream, FrameSequence, testing};

fn refine(tracks: &TrackSet, events: &EventStream, frames: &FrameSequence) -> TrackSet {
    let node = RefinePicture::build(Params::default()).unwrap();
    let input =
        In { tracks: tracks.clone(), events: events.clone(), frames: frames.clone(), sensor: sensor() };
    testing::with_context(EXTENT.rows(), &["tracks"], |cx| node.run(input, cx)).0.unwrap().tracks
}

#[test]
fn a_texture_that_slides_comes_out_better() {
    let (events, frames) = record(texture);
    let alone = solve(&events, &frames);
    let together = refine(&alone, &events, &frames);
    let (before, after) = (error(&alone, texture), error(&together, texture));
    assert!(decibels(before, after) > 3.0, "{before} became {after}: {} dB", decibels(before, after));
}

#[test]
fn pixels_that_have_nothing_to_do_with_each_other_stay_as_they_are() {
    let (events, frames) = record(every_pixel_for_itself);
    let alone = solve(&events, &frames);
    let together = refine(&alone, &events, &frames);
    let (before, after) = (error(&alone, every_pixel_for_itself), error(&together, every_pixel_for_itself));
    assert!(decibels(before, after) > -0.1, "{before} became {after}: {} dB", decibels(before, after));
}

#[test]
fn threads_do_not_change_a_bit() {
    let (events, frames) = record(texture);
    let alone = solve(&events, &frames);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| refine(&alone, &events, &frames).read(EXTENT.rows()).unwrap())
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn pictures_of_parts_of_a_long_recording_predict_the_light_where_frames_say_so() {
    let (events, frames) = record(texture);
    let case = Case::read(Some(&events), Some(&frames), &sensor()).unwrap();
    let nominal = photocurrent_scene::nominal::Nominal::of(&sensor());
    let pixels = EXTENT.pixels();
    let fit = |most_values: usize| {
        PredictedPictures::fit(
            &case,
            &nominal,
            &PictureSetting { most_values, ..PictureSetting::default() },
            (250_000, 0.25),
            |_| vec![true; pixels],
        )
    };
    // All five frames at once, and two parts of four.
    for most in [5, 4] {
        let pictures = fit(most * pixels).unwrap();
        let rows: Vec<PredictedRowLight> =
            (0..16).map(|row| pictures.row_light(row, 24, &[9, 11, 12, 15])).collect();
        let (mut squares, mut count) = (0.0, 0.0);
        for n in 0..60 {
            let t_ns = 4_000_000 + n * 500_000;
            for (x, y) in [(12, 8), (9, 6), (15, 9), (11, 11)] {
                if let Some(predicted) = pictures.predict(&rows[y], (x, y), t_ns) {
                    let off = predicted.log - texture(x, y, t_ns as f64 * 1e-6);
                    (squares, count) = (squares + off * off, count + 1.0);
                }
            }
        }
        let rms = libm::sqrt(squares / count);
        assert!(count > 120.0 && rms < 0.03, "{most} frames at a time: {rms} of {count}");
        assert!(
            pictures.predict(&rows[8], (12, 8), 60_000_000).is_none(),
            "nothing is predicted after the last frame"
        );
    }
    assert!(fit(2 * pixels).err().unwrap().contains("2 are fitted at a time"));
}

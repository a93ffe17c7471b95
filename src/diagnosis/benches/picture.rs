//! Times three steps on a simulated scene: fitting a moving picture to its frames, fitting it again to
//! similar frames, and evaluating every effect on its events.
//!
//! Run with `cargo bench -p photocurrent-diagnosis --bench picture`; the argument is the array's width, three
//! quarters of it are its height.

use divan::Bencher;
use photocurrent_core::Extent;
use photocurrent_diagnosis::residual::evidence::EvidenceSetting;
use photocurrent_diagnosis::residual::ranking::evidence;
use photocurrent_diagnosis::scenes::SimulatedScene;
use photocurrent_scene::case::Case;
use photocurrent_scene::moving::MovingPicture;
use photocurrent_scene::nominal::Nominal;
use photocurrent_scene::picture::{PictureSetting, ScenePicture};

const WIDTHS: [u32; 2] = [24, 48];

fn main() {
    divan::main();
}

fn recording(width: u32) -> (Case, Nominal) {
    let case = SimulatedScene::new(3, 2, Extent { width, height: width * 3 / 4 }, 0.15)
        .recording()
        .expect("a scene is made");
    let nominal = case.nominal().expect("its sensor is stated");
    (case, nominal)
}

#[divan::bench(args = WIDTHS, sample_count = 5)]
fn fit(bencher: Bencher<'_, '_>, width: u32) {
    let (case, nominal) = recording(width);
    bencher.bench(|| ScenePicture::fit(&case, &nominal, &PictureSetting::default()));
}

#[divan::bench(args = WIDTHS, sample_count = 5)]
fn refit(bencher: Bencher<'_, '_>, width: u32) {
    let (case, nominal) = recording(width);
    let picture = ScenePicture::fit(&case, &nominal, &PictureSetting::default()).expect("it is fitted");
    bencher.bench(|| picture.refit(&case, &nominal, &PictureSetting::default(), None));
}

#[divan::bench(args = [48], sample_count = 3)]
fn every_effect(bencher: Bencher<'_, '_>, width: u32) {
    let (case, nominal) = recording(width);
    let setting = PictureSetting::default();
    let source = MovingPicture::fit(&case, &nominal, &setting).expect("it is fitted");
    bencher.bench(|| evidence(&case, &nominal, &source, &EvidenceSetting::default()));
}

//! The table of contents: every node kind, in the order in which data flows. Nothing else registers nodes.

use crate::{
    align, baseline, compensate, diagnose, estimate, read, refine, render, score, simulate, solve, split,
    write,
};
use photocurrent_core::{Catalogue, Kind};

/// Names that kinds had before, each with what to write in its place.
const RETIRED: [(&str, &str); 1] = [(
    "solve/pixel",
    "write `solve/map`, the MAP estimate, or `solve/paper`, the paper's least squares, and take `method` \
     out: what was stated for one method is a parameter of its kind",
)];

/// All node kinds.
pub fn catalogue() -> Catalogue {
    let mut kinds = vec![
        // Data come in, or are made.
        Kind::of::<read::recording::ReadRecording>(),
        Kind::of::<read::sensor::ReadSensor>(),
        Kind::of::<read::alignment::ReadAlignment>(),
        Kind::of::<simulate::scene::SimulateScene>(),
        Kind::of::<simulate::video::SimulateVideo>(),
        Kind::of::<simulate::photo::SimulatePhoto>(),
        Kind::of::<simulate::sensor::SimulateSensor>(),
        // Parts are set aside.
        Kind::of::<split::frames::SplitFrames>(),
        Kind::of::<split::time::SplitTime>(),
        // Events and frames become photocurrent.
        Kind::of::<compensate::readout::CompensateReadout>(),
        Kind::of::<align::light::AlignLight>(),
        Kind::of::<align::recording::AlignRecording>(),
        Kind::of::<render::grey::RenderGrey>(),
        Kind::of::<solve::map::SolveMap>(),
        Kind::of::<solve::paper::SolvePaper>(),
        Kind::of::<refine::steered::RefineSteered>(),
        Kind::of::<refine::motion::RefineMotion>(),
        Kind::of::<refine::picture::RefinePicture>(),
        Kind::of::<align::tracks::AlignTracks>(),
        // Photocurrent becomes frames.
        Kind::of::<solve::frames::SolveFrames>(),
        Kind::of::<render::rows::RenderRows>(),
        Kind::of::<render::demosaic::RenderDemosaic>(),
        Kind::of::<refine::onnx::RefineOnnx>(),
        Kind::of::<render::colour::RenderColour>(),
        // The same by other methods.
        Kind::of::<baseline::repeat::BaselineRepeat>(),
        Kind::of::<baseline::contrast::BaselineContrast>(),
        Kind::of::<baseline::edi::BaselineEdi>(),
        Kind::of::<baseline::cf::BaselineCf>(),
        Kind::of::<baseline::akf::BaselineAkf>(),
        Kind::of::<baseline::external::BaselineExternal>(),
        Kind::of::<baseline::exec::BaselineExec>(),
        Kind::of::<baseline::onnx::BaselineOnnx>(),
        // How good it is.
        Kind::of::<score::psnr::ScorePsnr>(),
        Kind::of::<score::ssim::ScoreSsim>(),
        Kind::of::<score::lpips::ScoreLpips>(),
        Kind::of::<score::bew::ScoreBew>(),
        Kind::of::<score::pixel_error::ScorePixelError>(),
        Kind::of::<score::glitch::ScoreGlitch>(),
        Kind::of::<score::coverage::ScoreCoverage>(),
        Kind::of::<score::heldout::ScoreHeldout>(),
        Kind::of::<score::diagnosis::ScoreDiagnosis>(),
        // What the file does not say.
        Kind::of::<estimate::offset::EstimateOffset>(),
        Kind::of::<estimate::row_time::EstimateRowTime>(),
        Kind::of::<estimate::thresholds::EstimateThresholds>(),
        Kind::of::<estimate::exposure::EstimateExposure>(),
        Kind::of::<estimate::alignment::EstimateAlignment>(),
        // What the description leaves out.
        Kind::of::<diagnose::integrity::DiagnoseIntegrity>(),
        Kind::of::<diagnose::target::DiagnoseTarget>(),
        Kind::of::<diagnose::evidence::DiagnoseEvidence>(),
        Kind::of::<diagnose::decide::DiagnoseDecide>(),
        Kind::of::<diagnose::confirm::DiagnoseConfirm>(),
        // Files for the user.
        Kind::of::<write::recording::WriteRecording>(),
        Kind::of::<write::frames::WriteFrames>(),
        Kind::of::<write::video::WriteVideo>(),
        Kind::of::<write::table::WriteTable>(),
        Kind::of::<write::plot::WritePlot>(),
        Kind::of::<write::contact_sheet::WriteContactSheet>(),
        Kind::of::<write::diagnosis::WriteDiagnosis>(),
    ];
    // Other people's files come in behind our own recording.
    kinds.splice(1..1, read::formats::kinds());
    Catalogue::new(kinds).with_retired(&RETIRED)
}

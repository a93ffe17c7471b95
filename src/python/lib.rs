//! The Python package: what its Python sources (`photocurrent/`) call.
//!
//! Python builds manifests and shows results; everything that counts is done by the same crates as in the
//! command. Nothing here calculates, and no type of these crates is a Python class but what holds their
//! data: an opened file (`source`), the results of a run (`run`), a value (`values`).
//!
//! - `command`: every command of the program, with its streams as texts.
//! - `waiting`: work in a thread of its own, while Python receives its signals and progress.
//! - `events`: events as structured arrays, in the order of time.
//! - `arrays`: arrays as a recording in a file; events as voxel grids.

mod arrays;
mod command;
mod events;
mod run;
mod sensors;
mod source;
mod trouble;
mod values;
mod waiting;

use pyo3::prelude::*;

/// The command's own allocator: the joint estimate takes and leaves large blocks all the time.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<run::Run>()?;
    module.add_class::<source::Source>()?;
    module.add_class::<source::Chunks>()?;
    module.add_class::<values::Value>()?;
    module.add_function(wrap_pyfunction!(command::main, module)?)?;
    module.add_function(wrap_pyfunction!(command::command, module)?)?;
    module.add_function(wrap_pyfunction!(run::run, module)?)?;
    module.add_function(wrap_pyfunction!(sensors::sensor_to_json, module)?)?;
    module.add_function(wrap_pyfunction!(sensors::sensor_to_toml, module)?)?;
    module.add_function(wrap_pyfunction!(values::load, module)?)?;
    module.add_function(wrap_pyfunction!(arrays::write_recording, module)?)?;
    module.add_function(wrap_pyfunction!(arrays::voxels, module)?)?;
    module.add_function(wrap_pyfunction!(arrays::digest, module)?)?;
    module.add_function(wrap_pyfunction!(arrays::panic, module)?)
}

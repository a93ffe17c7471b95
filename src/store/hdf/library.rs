//! Calls into the HDF5 library: one at a time, with its printing off and the doors to other files shut.

use std::sync::LazyLock;

/// Runs library calls under the library's lock, with its printing off and the doors to other files shut.
pub(crate) fn locked<T>(calls: impl FnOnce() -> T) -> T {
    static SHUT: LazyLock<()> = LazyLock::new(|| {
        hdf5::sync::sync(|| {
            let mut no_plugins = 0;
            // SAFETY: both are plain calls into an initialised library, under its lock; the pointer is valid
            // for the call.
            unsafe {
                hdf5_sys::h5l::H5Lunregister(hdf5_sys::h5l::H5L_type_t::H5L_TYPE_EXTERNAL);
                hdf5_sys::h5pl::H5PLset_loading_state(&mut no_plugins);
            }
        });
    });
    LazyLock::force(&SHUT);
    hdf5::sync::sync(calls)
}

/// The library's message in one line: the deepest frame says most, and the rest repeats it.
pub(crate) fn short(error: &hdf5::Error) -> String {
    error.to_string().lines().next().unwrap_or("no reason given").to_string()
}

//! A link into another file is not followed.
//!
//! Alone in its binary: the store takes external links out of the library for the whole process, and the file
//! must be made before.
#![allow(clippy::unwrap_used)]

use photocurrent_store::open_value;

#[test]
fn a_link_into_another_file_is_not_followed() {
    let folder = tempfile::tempdir().unwrap();
    let (path, target) = (folder.path().join("bad.h5"), folder.path().join("target.h5"));
    let file = hdf5::File::create(&target).unwrap();
    file.new_dataset_builder().with_data(&[1.0f32; 8]).create("secret").unwrap();
    file.close().unwrap();
    let file = hdf5::File::create(&path).unwrap();
    for (name, text) in [("format", "photocurrent-artefact/1"), ("data_type", "frames")] {
        let text: hdf5::types::VarLenUnicode = text.parse().unwrap();
        file.new_attr::<hdf5::types::VarLenUnicode>().create(name).unwrap().write_scalar(&text).unwrap();
    }
    file.link_external(target.to_str().unwrap(), "/secret", "meta").unwrap();
    assert!(file.dataset("meta").is_ok(), "the library itself would follow it");
    file.close().unwrap();
    let error = open_value(&path).err().unwrap().to_string();
    assert!(error.contains("/meta: cannot open the dataset") && error.contains("bad.h5"), "{error}");
}

//! Files that are no recordings, made byte by byte, each with its own message.

use super::*;
use crate::npy::tests::stored;
use std::path::PathBuf;

fn probe(name: &str, bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    (folder, path)
}

/// The message about a file, and what to do; it is recognised as no recording.
fn said(name: &str, bytes: &[u8]) -> (String, String) {
    let (_folder, path) = probe(name, bytes);
    assert!(recognise(&path).unwrap().is_none(), "{name}");
    let instead =
        what_it_is(&Probe::new(&path).unwrap()).unwrap_or_else(|| panic!("{name}: nothing is known of it"));
    (instead.what, instead.todo)
}

/// NVIDIA/aerial-framework#4, wassname/satellite_leak_detection#1, aiqm/torchani#168: a file of HDF5 that is
/// "ASCII text" of three lines.
#[test]
fn a_pointer_of_git_lfs_is_named_whatever_it_is_called() {
    let pointer = format!(
        "version https://git-lfs.github.com/spec/v1\noid sha256:{}\nsize 123456789\n",
        "0123456789abcdef".repeat(4)
    );
    for name in ["pointer.raw", "pointer.h5", "pointer.aedat4", "pointer.npz", "events.txt"] {
        let (what, todo) = said(name, pointer.as_bytes());
        assert_eq!(what, "a Git LFS pointer to a file of 123456789 bytes, not the file itself");
        assert!(todo.contains("git lfs pull"), "{todo}");
        let (_folder, path) = probe(name, pointer.as_bytes());
        assert!(
            !may_be_stamps(&Probe::new(&path).unwrap()) || what_it_is(&Probe::new(&path).unwrap()).is_some()
        );
    }
    assert!(said("a.raw", b"../../.git/annex/objects/Xk/9z/SHA256E-s10--00.raw").0.contains("git-annex"));
}

#[test]
fn pages_and_messages_of_servers_and_empty_files_are_named() {
    let (what, todo) = said(
        "page.raw",
        b"<!DOCTYPE html><html><head><title>Sign in</title></head><body>Please sign in.</body></html>\n",
    );
    assert_eq!(what, "a web page (`Sign in`)");
    assert!(todo.contains("log in") && todo.contains("download again"), "{todo}");
    assert!(
        said("e.h5", b"<?xml version=\"1.0\"?><Error><Code>AccessDenied</Code></Error>")
            .0
            .contains("server's error message")
    );
    assert!(said("e.npz", b"{\"message\": \"Not Found\"}").0.contains("Not Found"));
    assert!(said("empty.raw", b"").0.contains("0 bytes"));
}

#[test]
fn archives_say_what_they_hold_and_how_to_unpack_them() {
    let (what, todo) = said(
        "packed.zip",
        &stored(&[("readme.md", b"x".to_vec()), ("run/events.raw", b"% evt 3.0\n".to_vec())]),
    );
    assert_eq!(what, "an archive (zip); it holds run/events.raw");
    assert!(todo.contains("unzip"), "{todo}");
    assert!(
        said("p.zip", &stored(&[("notes.md", b"x".to_vec())]))
            .0
            .contains("none of which looks like a recording")
    );
    assert!(said("model.pt", &stored(&[("archive/data.pkl", b"x".to_vec())])).0.contains("PyTorch"));
    assert!(said("cut.zip", &stored(&[("run/events.raw", vec![7; 400])])[..200]).0.contains("broke off"));
    let gzip = |bytes: &[u8]| {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        std::io::Write::write_all(&mut encoder, bytes).unwrap();
        encoder.finish().unwrap()
    };
    let (what, todo) = said(
        "packed.raw.gz",
        &gzip(b"% evt 3.0\n% format EVT3;height=720;width=1280\n% end\n\x00\x80\x00\x60"),
    );
    assert_eq!(what, "a file packed by gzip; it holds packed.raw, Prophesee RAW, EVT3");
    assert!(todo.contains("gunzip"), "{todo}");
    let mut tar = vec![0; 1024];
    tar[..10].copy_from_slice(b"events.raw");
    tar[257..262].copy_from_slice(b"ustar");
    assert!(said("p.tar", &tar).0.contains("its first entry is events.raw"));
    assert!(said("p.tgz", &gzip(&tar)).1.contains("tar xzf"));
    for (magic, command) in [
        (&b"\xfd7zXZ\0"[..], "xz -dk"),
        (b"BZh9", "bzip2 -dk"),
        (b"\x28\xb5\x2f\xfd", "zstd -d"),
        (b"7z\xbc\xaf\x27\x1c", "7z x"),
        (b"\x04\x22\x4d\x18", "lz4 -d"),
    ] {
        assert!(said("p.bin", &[magic, &[0; 64]].concat()).1.contains(command), "{command}");
    }
}

/// A variable of MATLAB, version 5: tag, flags, size, name.
fn matlab_variable(name: &str, class: u8, sides: [u32; 2]) -> Vec<u8> {
    let mut inner = Vec::new();
    let mut put = |kind: u32, content: &[u8]| {
        inner.extend(kind.to_le_bytes());
        inner.extend((content.len() as u32).to_le_bytes());
        inner.extend(content);
        inner.resize(inner.len().next_multiple_of(8), 0);
    };
    put(6, &[class, 0, 0, 0, 0, 0, 0, 0]);
    put(5, &[sides[0].to_le_bytes(), sides[1].to_le_bytes()].concat());
    put(1, name.as_bytes());
    put(9, &[0; 64]);
    let mut variable = 14_u32.to_le_bytes().to_vec();
    variable.extend((inner.len() as u32).to_le_bytes());
    variable.extend(inner);
    variable
}

#[test]
fn variables_of_matlab_are_listed_packed_or_not() {
    let mut file =
        format!("{:<124}", "MATLAB 5.0 MAT-file Platform: posix, Created on: Thu Nov 26 2026").into_bytes();
    file.extend([0, 1, b'I', b'M']);
    file.extend(matlab_variable("events", 6, [18_436, 4]));
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut encoder, &matlab_variable("TD", 2, [1, 1])).unwrap();
    let packed = encoder.finish().unwrap();
    file.extend(15_u32.to_le_bytes());
    file.extend((packed.len() as u32).to_le_bytes());
    file.extend(packed);
    let (what, todo) = said("events.mat", &file);
    assert_eq!(what, "a file of MATLAB (version 5 to 7); it holds events 18436 x 4 double, TD 1 x 1 struct");
    assert!(
        todo.contains("writematrix") && todo.contains("numpy.savez") && todo.contains("origin = 1"),
        "{todo}"
    );
    for length in 0..file.len() {
        let (_folder, path) = probe("cut.mat", &file[..length]);
        let _ = matlab::matlab(&Probe::new(&path).unwrap());
    }
}

#[test]
fn words_without_a_header_show_their_encoding() {
    let mut evt3: Vec<u16> = Vec::new();
    for k in 0..400_u16 {
        evt3.extend([
            0x8000 | (0x200 + k / 100),
            0x6000 | (k * 9 % 0xfff),
            k % 72,
            0x2000 | (k % 2) << 11 | (k % 96),
        ]);
    }
    let bytes: Vec<u8> = evt3.iter().flat_map(|word| word.to_le_bytes()).collect();
    let (what, todo) = said("headless.raw", &bytes);
    assert_eq!(what, "a file without a header that looks like EVT3 words");
    assert!(todo.contains("% evt 3.0") && todo.contains("height=720;width=1280"), "{todo}");
    // What is proposed makes it a recording.
    let header = b"% evt 3.0\n% format EVT3;height=720;width=1280\n% end\n";
    let (_folder, path) = probe("with_header.raw", &[&header[..], &bytes].concat());
    assert_eq!(recognise(&path).unwrap().map(|format| format.id), Some("evt3"));
    let evt2: Vec<u8> = (0..400_u32)
        .flat_map(|k| [0x8000_0000 | (1000 + k), (k % 2) << 28 | (k % 64) << 22 | (k % 96) << 11 | (k % 72)])
        .flat_map(u32::to_le_bytes)
        .collect();
    assert_eq!(said("headless.raw", &evt2).0, "a file without a header that looks like EVT2 words");
    let evt21: Vec<u8> = (0..400_u64)
        .flat_map(|k| {
            [8 << 60 | (1000 + k) << 32, (k % 2) << 60 | (k % 64) << 54 | (k % 3) << 43 | (k % 72) << 32 | 5]
        })
        .flat_map(u64::to_le_bytes)
        .collect();
    assert_eq!(said("headless.raw", &evt21).0, "a file without a header that looks like EVT2.1 words");
    // Noise, zeros and text are none.
    let mut state = 7_u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    let noise: Vec<u8> = (0..4096).map(|_| next()).collect();
    for bytes in [&noise[..], &[0; 4096], &b"Dear reader, these are words of another kind. ".repeat(60)] {
        let (_folder, path) = probe("other.raw", bytes);
        assert_eq!(what_it_is(&Probe::new(&path).unwrap()), None);
    }
}

#[test]
fn films_tables_pictures_and_objects_say_what_to_do() {
    let cases: [(&str, &[u8], &str, &str); 9] = [
        ("a.mp4", b"\0\0\0\x20ftypisom", "a film (MP4 or MOV)", "ffmpeg"),
        ("a.avi", b"RIFF\0\0\0\0AVI LIST", "a film (AVI)", "timestamps.txt"),
        ("a.mkv", b"\x1a\x45\xdf\xa3\x01", "a film (Matroska or WebM)", "ffmpeg"),
        ("a.parquet", b"PAR1\x15\x04", "a table in Parquet", "to_csv"),
        ("a.feather", b"ARROW1\0\0", "a table in Arrow", "read_feather"),
        ("a.pkl", b"\x80\x04\x95\x10", "pickled Python objects", "numpy.savez"),
        ("a.png", b"\x89PNG\r\n\x1a\n", "one picture (PNG)", "the folder"),
        ("a.jpg", b"\xff\xd8\xff\xe0", "one picture (JPEG)", "mogrify"),
        (
            "a.toml",
            b"format = \"photocurrent-sensor/1\"\n[comparator]\n",
            "a sensor description",
            "read/sensor",
        ),
    ];
    for (name, bytes, expected, next) in cases {
        let (what, todo) = said(name, bytes);
        assert!(what.contains(expected) && todo.contains(next), "{name}: {what}: {todo}");
    }
}

#[test]
fn hdf5_of_another_layout_lists_its_datasets() {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../data/formats/filters.h5");
    let instead = what_it_is(&Probe::new(&path).unwrap()).unwrap();
    assert!(instead.what.contains("/compound [300]") && instead.what.contains("more"), "{}", instead.what);
    assert!(instead.todo.contains("/events/t"), "{}", instead.todo);
    let all =
        |names: &[&str]| names.iter().map(|name| (name.to_string(), " [3]".to_string())).collect::<Vec<_>>();
    assert_eq!(
        inside::columns(&all(&["p", "t", "x", "y"])),
        Some((String::new(), ["t", "x", "y", "p"].map(String::from)))
    );
    assert_eq!(inside::columns(&all(&["cam/ts", "cam/X", "cam/y", "cam/pol"])).unwrap().0, "cam");
    assert_eq!(inside::columns(&all(&["cam/t", "x", "y", "p"])), None);
}

#[test]
fn folders_say_which_recordings_lie_in_them() {
    let folder = tempfile::tempdir().unwrap();
    let said = || what_it_is(&Probe::new(folder.path()).unwrap()).unwrap();
    assert!(said().what.contains("empty folder"));
    std::fs::write(folder.path().join("images.txt"), "0.1 images/a.png\n").unwrap();
    assert!(said().what.contains("without its events.txt"));
    std::fs::remove_file(folder.path().join("images.txt")).unwrap();
    std::fs::write(folder.path().join("notes.md"), "x").unwrap();
    assert!(said().what.contains("1 entries: notes.md"), "{}", said().what);
    std::fs::write(folder.path().join("events.csv"), "t_us,x,y,p\n1,2,3,1\n").unwrap();
    assert!(
        said().what.contains("events.csv") && said().todo.contains("one of the recordings"),
        "{}",
        said().what
    );
}

#[test]
fn texts_of_stamps_are_lines_of_numbers() {
    let is = |text: &str| {
        let (_folder, path) = probe("t.txt", text.as_bytes());
        may_be_stamps(&Probe::new(&path).unwrap())
    };
    assert!(
        is("2000\n22000\n42000\n")
            && is("# t_us\n2000\n")
            && is("t_us\n2000\n22000\n")
            && is("a.png 0.1\nb.png 0.2\n")
            && is("1,2\n3,4\n")
    );
    assert!(!is("Dear reader,\nthis is prose.\nIt goes on.\nAnd on.\n") && !is("a b c\n"));
}

#[test]
fn what_is_missing_of_pictures_is_no_other_kind_of_file() {
    let folder = tempfile::tempdir().unwrap();
    let error = FormatError::new(folder.path(), "no stamps", "state them").undeclared("stamps");
    let declared = Declared { frames: Some(folder.path().into()), ..Declared::default() };
    assert_eq!(explained(error.clone(), &declared), error, "an empty folder of frames is reported as it was");
    std::fs::write(folder.path().join("0.png"), b"\x89PNG\r\n\x1a\n").unwrap();
    assert_eq!(explained(error.clone(), &declared), error);
    // An archive of arrays of which one is missing is still that; a pointer in its place is none.
    let arrays = folder.path().join("events.npz");
    std::fs::write(&arrays, stored(&[("t.npy", vec![1; 80])])).unwrap();
    let missing = FormatError::new(&arrays, "no array for `x`", "save it");
    assert_eq!(explained(missing.clone(), &Declared::default()), missing);
    std::fs::write(&arrays, "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n").unwrap();
    assert!(
        explained(missing, &Declared::default()).found.contains("a Git LFS pointer to a file of 9 bytes")
    );
    let stamps = folder.path().join("t.txt");
    std::fs::write(&stamps, "2000\n22000\n").unwrap();
    let error = FormatError::new(&stamps, "the unit is not stated", "state it").undeclared("time_unit");
    let declared = Declared { stamps: Some(stamps), ..Declared::default() };
    assert_eq!(explained(error.clone(), &declared), error);
}

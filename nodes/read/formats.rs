//! The formats that have a node each: what it is called, where the format is described, which parameters mean
//! something for it.
//!
//! The recording of this project is read by `read/recording`, which also gives the truth of simulated data;
//! everything else is here.

use super::foreign::{Read, Reader, accepted};
use photocurrent_core::{Decl, Grain};

/// Declares formats as nodes.
macro_rules! readers {
    ($(
        $name:ident $kind:literal $format:literal $about:literal
        [$($source:literal),* $(,)?] accepts [$($param:literal),* $(,)?] example $example:literal;
    )*) => {
        $(
            #[doc = $about]
            pub struct $name;

            impl Reader for $name {
                const DECL: Decl = Decl {
                    kind: $kind,
                    about: $about,
                    revision: 4,
                    grain: Grain::Pixel,
                    draws: false,
                    exports: false,
                    sources: &[$($source),*],
                    example: concat!(
                        "\n[nodes.recording]\nkind   = \"", $kind, "\"\nparams = { ", $example, " }\n"
                    ),
                };
                const FORMAT: &'static str = $format;
                const ACCEPTS: &'static [&'static str] = &[$($param),*];
            }
        )*

        /// Does the reader of a format accept a parameter? That of own recordings accepts a row time.
        pub fn takes(format: &str, parameter: &str) -> bool {
            if format == "recording" {
                return parameter == "row_time";
            }
            $(
                if format == $format {
                    return accepted::<$name>(parameter);
                }
            )*
            false
        }

        /// Every node of this file, in reading order.
        pub fn kinds() -> Vec<photocurrent_core::Kind> {
            vec![$(photocurrent_core::Kind::of::<Read<$name>>()),*]
        }
    };
}

readers! {
    Aedat4 "read/aedat4" "aedat4"
        "Reads events and frames of an AEDAT4 file (DAVIS cameras)."
        ["AEDAT 4.0 file format, iniVation"]
        accepts [
            "extent", "camera", "frame_camera", "frame_offset", "exposure", "stamp", "row_time", "transfer",
        ]
        example "path = \"davis346_traffic.aedat4\", end = \"1 s\"";
    Aedat2 "read/aedat2" "aedat2"
        "Reads events of an AEDAT-2.0 file (jAER)."
        ["AEDAT 2.0 file format, jAER"]
        accepts [
            "extent", "camera", "frames", "stamps", "trigger_line", "frame_offset", "exposure", "stamp",
            "row_time", "transfer", "strobe", "first_pulse", "pairing",
        ]
        example "path = \"walk.aedat\"";
    EventStreamFile "read/event_stream" "event_stream"
        "Reads events of an Event Stream file (.es)."
        ["Event Stream 2.0, neuromorphic systems"]
        accepts [
            "extent", "frames", "stamps", "trigger_line", "frame_offset", "exposure", "stamp", "row_time",
            "transfer", "strobe", "first_pulse", "pairing",
        ]
        example "path = \"dvs.es\"";
    Evt2 "read/evt2" "evt2"
        "Reads events of a Prophesee RAW file, encoding EVT2."
        ["EVT 2.0 format, Prophesee"]
        accepts [
            "extent", "frames", "stamps", "trigger_line", "frame_offset", "exposure", "stamp", "row_time",
            "transfer", "strobe", "first_pulse", "pairing",
        ]
        example "path = \"street.raw\"";
    Evt21 "read/evt21" "evt21"
        "Reads events of a Prophesee RAW file, encoding EVT2.1."
        ["EVT 2.1 format, Prophesee"]
        accepts [
            "extent", "frames", "stamps", "trigger_line", "frame_offset", "exposure", "stamp", "row_time",
            "transfer", "strobe", "first_pulse", "pairing",
        ]
        example "path = \"street.raw\"";
    Evt3 "read/evt3" "evt3"
        "Reads events of a Prophesee RAW file, encoding EVT3."
        ["EVT 3.0 format, Prophesee"]
        accepts [
            "extent", "frames", "stamps", "trigger_line", "frame_offset", "exposure", "stamp", "row_time",
            "transfer", "strobe", "first_pulse", "pairing",
        ]
        example "path = \"street.raw\", frames = \"frames\", trigger_line = 0, row_time = \"0 us\", \
                 transfer = \"srgb\"";
    Dat "read/dat" "dat"
        "Reads events of a Prophesee DAT file."
        ["DAT format, Prophesee"]
        accepts [
            "extent", "frames", "stamps", "trigger_line", "frame_offset", "exposure", "stamp", "row_time",
            "transfer", "strobe", "first_pulse", "pairing",
        ]
        example "path = \"street_td.dat\"";
    PropheseeHdf5 "read/prophesee_hdf5" "prophesee_hdf5"
        "Reads events of a Prophesee HDF5 file, ECF codec included."
        ["HDF5 event files, Prophesee", "ECF codec, filter 0x8ECF"]
        accepts [
            "extent", "frames", "stamps", "trigger_line", "frame_offset", "exposure", "stamp", "row_time",
            "transfer", "strobe", "first_pulse", "pairing",
        ]
        example "path = \"street.hdf5\"";
    Dsec "read/dsec" "dsec"
        "Reads events of a DSEC file, and the frames of a DSEC sequence."
        ["Gehrig et al., DSEC: A Stereo Event Camera Dataset for Driving Scenarios, RA-L 2021"]
        accepts [
            "extent", "time_unit", "camera", "frame_camera", "frames", "stamps", "trigger_line",
            "frame_offset", "exposure", "stamp", "row_time", "transfer", "polarity", "origin", "counter",
            "strobe", "first_pulse", "pairing",
        ]
        example "path = \"interlaken_00_c/events/left/events.h5\"";
    M3ed "read/m3ed" "m3ed"
        "Reads events and frames of an M3ED file."
        ["Chaney et al., M3ED: Multi-Robot, Multi-Sensor, Multi-Environment Event Dataset, CVPRW 2023"]
        accepts [
            "extent", "camera", "frame_camera", "frame_offset", "exposure", "stamp", "row_time", "transfer",
            "polarity", "origin", "counter", "first_pulse", "pairing",
        ]
        example "path = \"car_urban_day.h5\", exposure = \"2 ms\", stamp = \"middle\", transfer = \"linear\"";
    Mvsec "read/mvsec" "mvsec"
        "Reads events and frames of an MVSEC file."
        ["Zhu et al., The Multi Vehicle Stereo Event Camera Dataset, RA-L 2018"]
        accepts [
            "extent", "camera", "frame_camera", "frame_offset", "exposure", "stamp", "row_time", "transfer",
            "polarity", "origin", "counter", "first_pulse", "pairing",
        ]
        example "path = \"outdoor_day1_data.hdf5\", exposure = \"5 ms\", stamp = \"middle\"";
    V2eHdf5 "read/v2e_hdf5" "v2e_hdf5"
        "Reads events and frames of an HDF5 file of the simulator v2e."
        ["Hu et al., v2e: From Video Frames to Realistic DVS Events, CVPRW 2021"]
        accepts [
            "extent", "time_unit", "coordinate_scale", "frame_offset", "exposure", "stamp", "row_time",
            "transfer", "polarity", "origin", "counter", "first_pulse", "pairing",
        ]
        example "path = \"v2e.h5\", exposure = \"3 ms\", stamp = \"start\", row_time = \"0 us\", transfer = \
                 \"srgb\"";
    EventUtilsHdf5 "read/event_utils_hdf5" "event_utils_hdf5"
        "Reads events and frames of an HDF5 file of event_utils."
        ["Stoffregen et al., Reducing the Sim-to-Real Gap for Event Cameras, ECCV 2020"]
        accepts [
            "extent", "time_unit", "coordinate_scale", "frame_offset", "exposure", "stamp", "row_time",
            "transfer", "polarity", "origin", "counter",
        ]
        example "path = \"slider.h5\", exposure = \"5 ms\", stamp = \"middle\", row_time = \"0 us\", \
                 transfer = \"linear\"";
    Memmap "read/memmap" "memmap"
        "Reads events and frames of a folder of arrays (event_utils, EVREAL)."
        ["Ercan et al., EVREAL: Towards a Comprehensive Benchmark, CVPRW 2023"]
        accepts [
            "extent", "time_unit", "coordinate_scale", "frame_offset", "exposure", "stamp", "row_time",
            "transfer", "polarity", "origin", "counter", "first_pulse", "pairing",
        ]
        example "path = \"boxes_6dof\", exposure = \"5 ms\", stamp = \"middle\", row_time = \"0 us\", \
                 transfer = \"linear\"";
    Ecd "read/ecd" "ecd"
        "Reads a folder of the Event Camera Dataset: events.txt and PNG pictures."
        ["Mueggler et al., The Event-Camera Dataset and Simulator, IJRR 2017"]
        accepts [
            "extent", "time_unit", "frame_offset", "exposure", "stamp", "row_time", "transfer", "polarity",
            "origin", "counter",
        ]
        example "path = \"slider_depth\", exposure = \"5 ms\", stamp = \"middle\"";
    HsErgb "read/hs_ergb" "hs_ergb"
        "Reads a sequence of HS-ERGB or BS-ERGB: npz events and PNG pictures."
        ["Tulyakov et al., Time Lens, CVPR 2021", "Tulyakov et al., Time Lens++, CVPR 2022"]
        accepts [
            "extent", "time_unit", "coordinate_scale", "frame_offset", "exposure", "stamp", "row_time",
            "transfer", "polarity", "origin", "counter", "first_pulse", "pairing",
        ]
        example "path = \"far/test/bridge_lake_01\", exposure = \"1 ms\", stamp = \"middle\", transfer = \
                 \"srgb\"";
    Csv "read/csv" "csv"
        "Reads events of a text file: commas, tabs or blanks, with a header or declared columns."
        ["docs/formats.md"]
        accepts [
            "extent", "time_unit", "columns", "coordinate_scale", "frames", "stamps", "trigger_line",
            "frame_offset", "exposure", "stamp", "row_time", "transfer", "polarity", "origin", "counter",
            "strobe", "first_pulse", "pairing",
        ]
        example "path = \"events.txt\", columns = [\"t\", \"x\", \"y\", \"p\"], time_unit = \"s\", extent = \
                 { width = 240, height = 180 }";
    Npz "read/npz" "npz"
        "Reads events of an npz or npy file of NumPy."
        ["NumPy enhancement proposal 1, the .npy format"]
        accepts [
            "extent", "time_unit", "columns", "coordinate_scale", "frames", "stamps", "trigger_line",
            "frame_offset", "exposure", "stamp", "row_time", "transfer", "polarity", "origin", "counter",
            "strobe", "first_pulse", "pairing",
        ]
        example "path = \"events.npz\", time_unit = \"us\"";
    Rosbag "read/rosbag" "rosbag"
        "Reads events and images of a ROS 1 bag."
        ["ROS bag format 2.0", "dvs_msgs, prophesee_event_msgs, event_camera_msgs, sensor_msgs"]
        accepts [
            "extent", "camera", "frame_camera", "frame_offset", "exposure", "stamp", "row_time", "transfer",
        ]
        example "path = \"office.bag\", camera = \"/dvs/events\", exposure = \"5 ms\", stamp = \"middle\", \
                 row_time = \"0 us\", transfer = \"linear\"";
    Mcap "read/mcap" "mcap"
        "Reads events and images of an MCAP file (ROS 1 or ROS 2 messages)."
        ["MCAP specification", "event_camera_msgs, sensor_msgs"]
        accepts [
            "extent", "camera", "frame_camera", "frame_offset", "exposure", "stamp", "row_time", "transfer",
        ]
        example "path = \"office.mcap\", camera = \"/event_camera/events\"";
    Pictures "read/pictures" "pictures"
        "Reads frames from a folder of PNG, TIFF or JPEG pictures, or from a Y4M file."
        ["PNG, TIFF 6.0, JPEG (ITU-T T.81), YUV4MPEG2"]
        accepts [
            "stamps", "time_unit", "exposure", "stamp", "row_time", "transfer", "frame_offset",
            "first_pulse", "pairing",
        ]
        example "path = \"frames\", stamps = \"timestamps.txt\", time_unit = \"us\", exposure = \"2 ms\", \
                 stamp = \"start\", row_time = \"0 us\", transfer = \"srgb\"";
    Aedat3 "read/aedat3" "aedat3"
        "Reads events and frames of an AEDAT 3.1 file (cAER)."
        ["AEDAT 3.1 file format, iniVation"]
        accepts [
            "extent", "camera", "frames", "stamps", "trigger_line", "frame_offset", "exposure", "stamp",
            "row_time", "transfer",
        ]
        example "path = \"davis240_walk.aedat\", end = \"1 s\"";
    Rosbag2 "read/rosbag2" "rosbag2"
        "Reads events and images of a ROS 2 bag: its folder, or a file in SQLite (.db3)."
        ["rosbag2, storage sqlite3 and mcap", "dvs_msgs, event_camera_msgs, sensor_msgs"]
        accepts [
            "extent", "camera", "frame_camera", "frame_offset", "exposure", "stamp", "row_time", "transfer",
        ]
        example "path = \"office_bag\", camera = \"/event_camera/events\"";
}

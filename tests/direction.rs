//! Which crates there are, and which of ours each may depend on.

/// The names of our crates' folders, and which of ours each may depend on, directly or for its tests.
pub const DIRECTION: [(&str, &str, &[&str]); 13] = [
    ("src/core", "photocurrent-core", &[]),
    ("src/sensor", "photocurrent-sensor", &["photocurrent-core"]),
    ("src/solve", "photocurrent-solve", &["photocurrent-core", "photocurrent-sensor"]),
    ("src/gpu", "photocurrent-gpu", &["photocurrent-core", "photocurrent-sensor", "photocurrent-solve"]),
    ("src/scene", "photocurrent-scene", &["photocurrent-core", "photocurrent-sensor"]),
    ("src/page", "photocurrent-page", &[]),
    (
        "src/diagnosis",
        "photocurrent-diagnosis",
        &[
            "photocurrent-core",
            "photocurrent-sensor",
            "photocurrent-solve",
            "photocurrent-scene",
            "photocurrent-page",
        ],
    ),
    ("src/store", "photocurrent-store", &["photocurrent-core"]),
    (
        "src/formats",
        "photocurrent-formats",
        &["photocurrent-core", "photocurrent-sensor", "photocurrent-store"],
    ),
    ("src/engine", "photocurrent-engine", &["photocurrent-core", "photocurrent-store"]),
    (
        "src/calibrate",
        "photocurrent-calibrate",
        &["photocurrent-core", "photocurrent-scene", "photocurrent-diagnosis"],
    ),
    (
        "nodes",
        "photocurrent-nodes",
        &[
            "photocurrent-core",
            "photocurrent-sensor",
            "photocurrent-solve",
            "photocurrent-gpu",
            "photocurrent-scene",
            "photocurrent-diagnosis",
            "photocurrent-store",
            "photocurrent-formats",
        ],
    ),
    (
        "src/python",
        "photocurrent-python",
        &[
            "photocurrent",
            "photocurrent-core",
            "photocurrent-store",
            "photocurrent-formats",
            "photocurrent-engine",
            "photocurrent-nodes",
        ],
    ),
];

//! Thresholds that are judged.

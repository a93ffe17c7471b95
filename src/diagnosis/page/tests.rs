//! Pages are whole, and safe to open.

use super::*;
use crate::diagnose::{Setting, broken, diagnose};
use crate::testing;

#[test]
fn a_page_is_whole_and_needs_nothing_beside_it() {
    let case = testing::case();
    let found = diagnose(&case, &Setting::default(), &[], |_| ()).unwrap();
    let html = page(&found.report, Some(&case), Some(&found));
    for part in ["<!doctype html>", "consistent", "Frames that were kept back", "Three pixels", "says nothing about", "</html>"] {
        assert!(html.contains(part), "{part}");
    }
    // Nothing is loaded from elsewhere, and no number failed.
    for part in ["src=", "<link", "<script", "NaN", "inf"] {
        assert!(!html.contains(part), "{part}");
    }
    for tag in ["svg", "table", "div", "h2", "p"] {
        let (open, close) = (html.matches(&format!("<{tag}>")).count() + html.matches(&format!("<{tag} ")).count(), html.matches(&format!("</{tag}>")).count());
        assert_eq!(open, close, "{tag}");
    }
    assert_eq!(html, page(&found.report, Some(&case), Some(&found)));
}

#[test]
fn text_of_a_file_cannot_become_markup() {
    let html = page(&broken("<script>alert(1)</script> & more", 1), None, None);
    assert!(html.contains("&lt;script&gt;alert(1)&lt;/script&gt; &amp; more") && !html.contains("<script"));
}

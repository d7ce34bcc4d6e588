//! The page, part of the program.

pub(super) const PAGE: &str = include_str!("web/index.html");

const SCRIPT: &str = "text/javascript; charset=utf-8";

/// A part of the page by its name: type and text.
pub(super) fn find(name: &str) -> Option<(&'static str, &'static str)> {
    Some(match name {
        "viewer.css" => ("text/css; charset=utf-8", include_str!("web/viewer.css")),
        "viewer.js" => (SCRIPT, include_str!("web/viewer.js")),
        _ => return None,
    })
}

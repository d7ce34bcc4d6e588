//! The report of `cape table2`, the page of `cape view` and those of studies as a browser shows them.
//!
//! Needs Chromium: the one that `CAPE_BROWSER` names, else one in the path; without any, the tests
//! report themselves as skipped. The folder of `cape view --export` is also opened in Firefox, which
//! `CAPE_FIREFOX` names or which is in the path, on a display of Xvfb. `CAPE_BROWSER_SHOTS` names a
//! directory to keep the screenshots and the page's glTF file in.

mod browser;
#[cfg(feature = "view")]
mod devtools;
#[cfg(feature = "view")]
mod firefox;
mod report;
#[cfg(feature = "view")]
mod serve;
#[cfg(feature = "view")]
mod site;
#[cfg(feature = "view")]
mod study;
#[allow(dead_code, reason = "shared with tests/cli, which uses all of it")]
#[path = "../cli/support.rs"]
mod support;
#[cfg(feature = "view")]
mod viewer;

#[cfg(feature = "view")]
use std::path::Path;
use std::{fs, path::PathBuf};

use cape::render::Image;

/// Directory for what is kept, if that is wanted.
fn kept() -> Option<PathBuf> {
    let directory = PathBuf::from(std::env::var_os("CAPE_BROWSER_SHOTS")?);
    fs::create_dir_all(&directory).unwrap();
    Some(directory)
}

/// Keeps a screenshot.
fn keep(name: &str, image: &Image) {
    if let Some(directory) = kept() {
        image.save(directory.join(format!("{name}.png"))).unwrap();
    }
}

/// Keeps a file.
#[cfg(feature = "view")]
fn keep_file(name: &str, path: &Path) {
    if let Some(directory) = kept() {
        fs::copy(path, directory.join(name)).unwrap();
    }
}

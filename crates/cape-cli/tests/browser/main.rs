//! The report of `cape table2`, the page of `cape view` and those of studies as a browser shows them.
//!
//! Needs Chromium: the one that `CAPE_BROWSER` names, else one in the path; without any, the tests
//! report themselves as skipped. The folder of `cape view --export` is also opened in Firefox, which
//! `CAPE_FIREFOX` names or which is in the path, on a display of Xvfb. `CAPE_BROWSER_SHOTS` names a
//! directory to keep the screenshots in.

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

use std::{fs, path::PathBuf};

use cape::render::Image;

/// Keeps a screenshot, if that is wanted.
fn keep(name: &str, image: &Image) {
    if let Some(directory) = std::env::var_os("CAPE_BROWSER_SHOTS") {
        fs::create_dir_all(&directory).unwrap();
        image.save(PathBuf::from(directory).join(format!("{name}.png"))).unwrap();
    }
}

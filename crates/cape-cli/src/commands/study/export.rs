use std::path::PathBuf;

use cape_core::StagingDirectory;
use cape_study::{ExportOptions, StudyDesign, export_files, jatos_package};
use clap::{ArgGroup, Args};
use serde::Serialize;

use crate::{
    console::Console,
    error::{Error, Result},
    files,
    options::{at_least_one, require_extension},
};

/// Write a study as a static folder of jsPsych, or as a JATOS package.
///
/// The folder works on any web space, without anything from elsewhere. A rater's schedule follows from
/// PROLIFIC_PID or rater in the address; answers go to JATOS or DataPipe, or are saved as a file. Open
/// index.html?simulate=visual to see a simulated rater.
#[derive(Debug, Args)]
#[command(
    group(ArgGroup::new("target").required(true).args(["out", "jatos"])),
    after_help = "Examples:\n  cape study export study --out site\n  cape study export study --jatos \
                  study.jzip --completion 'https://app.prolific.com/submissions/complete?cc=CODE'\n  \
                  cape study export study --out site --pipe abcDEF123456"
)]
pub(crate) struct ExportArgs {
    /// Directory of a study, as written by `cape study make`.
    #[arg(value_name = "STUDY")]
    study: PathBuf,
    /// Folder to write; it must be empty or missing.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// JATOS package to write.
    #[arg(long, value_name = "FILE.jzip")]
    jatos: Option<PathBuf>,
    /// Number of schedules; raters beyond it repeat them.
    #[arg(long, default_value_t = 200, value_name = "N", value_parser = at_least_one)]
    raters: usize,
    /// Page to go to at the end, such as Prolific's completion link.
    #[arg(long, value_name = "URL", value_parser = link)]
    completion: Option<String>,
    /// Experiment of DataPipe (pipe.jspsych.org) to send answers to.
    #[arg(long, value_name = "ID", conflicts_with = "jatos")]
    pipe: Option<String>,
}

#[derive(Debug, Serialize)]
struct Report {
    out: PathBuf,
    files: usize,
    bytes: usize,
}

impl ExportArgs {
    pub(crate) fn run(self, console: Console) -> Result {
        let design = StudyDesign::load(&self.study)?;
        let options =
            ExportOptions { schedules: self.raters, completion: self.completion, pipe: self.pipe };
        let written = export_files(&design, &self.study, &options)?;
        let bytes = written.values().map(Vec::len).sum();
        let out = match (self.out, self.jatos) {
            (Some(out), _) => {
                files::require_empty(&out)?;
                let staging = StagingDirectory::create(&out)?;
                files::create_dir(&staging.path.join("stimuli"))?;
                for (name, bytes) in &written {
                    files::write_bytes(&staging.path.join(name), bytes)?;
                }
                staging.commit(&out)?;
                out
            }
            (None, Some(package)) => {
                require_extension("--jatos", &package, "jzip")?;
                files::write_bytes(&package, &jatos_package(&design, &written)?)?;
                package
            }
            (None, None) => return Err(Error::message("expected --out or --jatos")),
        };
        let report = Report { files: written.len(), bytes, out };
        console.result(&report, || {
            let size = bytes as f64 / 1e6;
            format!("{} files, {size:.1} MB\n{}", report.files, report.out.display())
        })
    }
}

/// Parses a web address.
pub(super) fn link(text: &str) -> Result<String, String> {
    if text.starts_with("https://") || text.starts_with("http://") {
        Ok(text.to_owned())
    } else {
        Err("expected an address that begins with https:// or http://".into())
    }
}

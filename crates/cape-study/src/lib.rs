//! Perceptual studies of generated clothing (CAPE §6.2, table 3): people see two pictures, one of a
//! registration and one generated, and choose the one that they take for real.
//!
//! A [`StudyDesign`] lists the pairs of pictures and gives each rater a schedule with balanced order and
//! sides. [`read_answers`] reads what raters answered, [`StudyScore`] has the share of generated
//! pictures that were taken for real, with intervals over raters and pairs, [`plan`] the precision that
//! a number of raters will give. [`export_files`] makes a static page of it. [`stand_in_answers`] puts a
//! classifier in place of raters, for development.
//!
//! ```
//! // Raters who agree on nothing.
//! let units = [vec![true, false], vec![true, false], vec![false, true]];
//! assert!(cape_study::krippendorff_alpha(&units).is_some_and(|alpha| alpha < 0.0));
//! ```

mod agreement;
mod answers;
mod design;
mod export;
mod schedule;
mod score;
mod simulation;
mod stand_in;
pub mod web;

use std::{fs, path::Path};

pub use cape_core::{Error, Result};

pub use agreement::krippendorff_alpha;
pub use answers::{Answer, read_answers};
pub use design::{PairKind, Stimulus, StimulusPair, StudyCase, StudyDesign, stimulus_name};
pub use export::{ExportOptions, export_files, jatos_package};
pub use schedule::Trial;
pub use score::{CaseScore, ExcludedRater, ScoreOptions, StudyScore};
pub use simulation::{PlannedPrecision, RaterModel, plan};
pub use stand_in::{STAND_IN, stand_in_answers};

/// Largest size of the text of consent, bytes.
const MOST_CONSENT: u64 = 64 * 1024;

/// Paragraphs of `consent.txt`, which raters agree to before the study in `directory` begins.
///
/// # Errors
/// If the file is missing or longer than 64 kB.
pub fn consent(directory: impl AsRef<Path>) -> Result<Vec<String>> {
    let path = directory.as_ref().join("consent.txt");
    let size = fs::metadata(&path).map_err(|source| Error::io(&path, source))?.len();
    if size > MOST_CONSENT {
        return Err(Error::format(&path, format!("{size} bytes, expected at most {MOST_CONSENT}")));
    }
    let text = fs::read_to_string(&path).map_err(|source| Error::io(&path, source))?;
    let paragraphs = text.split("\n\n").map(|part| part.split_whitespace().collect::<Vec<_>>());
    Ok(paragraphs.map(|words| words.join(" ")).filter(|part| !part.is_empty()).collect())
}

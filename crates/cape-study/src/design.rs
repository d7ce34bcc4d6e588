//! The pairs of a study and what is known of their pictures.

use std::{collections::BTreeSet, fs, io::Write, path::Path};

use cape_core::{Error, Outfit, Result, hex, write_atomically};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// Name of the design in a study's directory.
const DESIGN: &str = "design.json";
/// Directory of the pictures.
pub(crate) const STIMULI: &str = "stimuli";
/// Version of the format.
const VERSION: u32 = 1;
/// Largest number of pairs.
const MOST_PAIRS: usize = 100_000;
/// Largest size of a design, bytes.
const MOST_BYTES: u64 = 256 << 20;

/// Purpose of a pair.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PairKind {
    /// Pair that is scored.
    Scored,
    /// Obvious pair that tests a rater's attention.
    Catch,
    /// Pair before the others, after which the rater is told the answer.
    Practice,
}

/// Kind of bodies in a pair.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StudyCase {
    /// One outfit in various poses, the paper's first case.
    Poses,
    /// All outfits in the A-pose, the paper's second case.
    APose,
    /// The same outfit and pose on both sides.
    Matched,
}

impl StudyCase {
    /// All cases.
    pub const ALL: [Self; 3] = [Self::Poses, Self::APose, Self::Matched];

    /// Name in files and tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Poses => "poses",
            Self::APose => "a-pose",
            Self::Matched => "matched",
        }
    }

    /// The share of generated bodies that the paper's raters took for real (§6.2, table 3).
    pub const fn paper(self) -> Option<f64> {
        match self {
            Self::Poses => Some(0.351),
            Self::APose => Some(0.387),
            Self::Matched => None,
        }
    }
}

/// Picture of a pair.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stimulus {
    /// File in `stimuli/`, named by its content, which does not tell the source.
    pub file: String,
    /// Held-out frame that the picture's clothing or pose is of.
    pub frame: usize,
}

/// Two pictures of one outfit, one of each source.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StimulusPair {
    /// Purpose.
    pub kind: PairKind,
    /// Kind of bodies.
    pub case: StudyCase,
    /// Outfit on both sides.
    pub outfit: Outfit,
    /// Picture of the source that is real, or stands for it.
    pub real: Stimulus,
    /// Picture of the source under test.
    pub generated: Stimulus,
}

impl StimulusPair {
    /// The files in alphabetical order, which does not depend on the sources.
    pub fn files(&self) -> [&str; 2] {
        let mut files = [self.real.file.as_str(), self.generated.file.as_str()];
        files.sort_unstable();
        files
    }
}

/// A study: its pairs, and the number of trials of a rater.
///
/// ```
/// use cape_core::Outfit;
/// use cape_study::{PairKind, Stimulus, StimulusPair, StudyCase, StudyDesign, stimulus_name};
///
/// let stimulus = |text: &str| Stimulus { file: stimulus_name(text.as_bytes()), frame: 0 };
/// let pairs = (0..4).map(|pair| StimulusPair {
///     kind: PairKind::Scored,
///     case: StudyCase::APose,
///     outfit: Outfit::LONG_LONG,
///     real: stimulus(&format!("real {pair}")),
///     generated: stimulus(&format!("generated {pair}")),
/// });
/// let design = StudyDesign::new(7, 4, ["registrations", "runs/cape"], pairs.collect())?;
/// // Two raters see each pair with the sides exchanged.
/// let left = |rater| {
///     let mut trials = design.schedule(rater);
///     trials.sort_by_key(|trial| trial.pair);
///     trials.into_iter().map(|trial| trial.left).collect::<Vec<_>>()
/// };
/// assert!(left(0).iter().zip(left(1)).all(|(a, b)| *a != b));
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StudyDesign {
    version: u32,
    /// Seed of pictures, order and sides.
    pub seed: u64,
    /// Number of scored pairs that a rater sees.
    pub trials: usize,
    /// Names of the sources: real, generated.
    pub sources: [String; 2],
    /// Pairs; a trial names its pair by the index.
    pub pairs: Vec<StimulusPair>,
}

impl StudyDesign {
    /// A study of `pairs`, of which each rater sees `trials` scored ones.
    ///
    /// # Errors
    /// If no pair is scored, the pictures of a pair are the same, or there are more trials than pairs.
    pub fn new(
        seed: u64,
        trials: usize,
        sources: [&str; 2],
        pairs: Vec<StimulusPair>,
    ) -> Result<Self> {
        let sources = sources.map(ToOwned::to_owned);
        let design = Self { version: VERSION, seed, trials, sources, pairs };
        design.fault().map_or(Ok(design), |(field, message)| {
            Err(Error::argument(format!("study: {field}: {message}")))
        })
    }

    /// Reads the design of the study in `directory`.
    ///
    /// # Errors
    /// If the file is missing, of another version or inconsistent.
    pub fn load(directory: impl AsRef<Path>) -> Result<Self> {
        let path = directory.as_ref().join(DESIGN);
        let size = fs::metadata(&path).map_err(|source| Error::io(&path, source))?.len();
        if size > MOST_BYTES {
            return Err(Error::format(
                &path,
                format!("{size} bytes, expected the design of a study"),
            ));
        }
        let text = fs::read(&path).map_err(|source| Error::io(&path, source))?;
        let design: Self = serde_json::from_slice(&text)
            .map_err(|error| Error::format(&path, error.to_string()))?;
        match design.fault() {
            None => Ok(design),
            Some((field, message)) => Err(Error::field(&path, field, message)),
        }
    }

    /// Writes `design.json` into `directory`.
    pub fn save(&self, directory: impl AsRef<Path>) -> Result<()> {
        let path = directory.as_ref().join(DESIGN);
        let text = serde_json::to_vec_pretty(self)
            .map_err(|error| Error::format(&path, error.to_string()))?;
        write_atomically(&path, |file| file.write_all(&text))
    }

    /// Indices of the pairs of a kind.
    pub fn of_kind(&self, kind: PairKind) -> Vec<usize> {
        (0..self.pairs.len()).filter(|&pair| self.pairs[pair].kind == kind).collect()
    }

    /// Names of all pictures.
    pub fn stimuli(&self) -> BTreeSet<&str> {
        self.pairs.iter().flat_map(StimulusPair::files).collect()
    }

    /// The field that is wrong, and how.
    fn fault(&self) -> Option<(String, String)> {
        if self.version != VERSION {
            let message = format!("{}, expected {VERSION}: make the study anew", self.version);
            return Some(("version".into(), message));
        }
        if self.pairs.len() > MOST_PAIRS {
            let message = format!("{} pairs, expected at most {MOST_PAIRS}", self.pairs.len());
            return Some(("pairs".into(), message));
        }
        for (index, pair) in self.pairs.iter().enumerate() {
            let files = pair.files();
            if let Some(file) = files.iter().find(|file| !is_stimulus_name(file)) {
                return Some((
                    format!("pairs[{index}]"),
                    format!("`{file}` is no name of a picture"),
                ));
            }
            if files[0] == files[1] {
                return Some((format!("pairs[{index}]"), "both pictures are the same".into()));
            }
        }
        let scored = self.of_kind(PairKind::Scored).len();
        if !(1..=scored).contains(&self.trials) {
            let message = format!("{}, expected 1 to {scored}, the scored pairs", self.trials);
            return Some(("trials".into(), message));
        }
        None
    }
}

/// File name of a picture of these bytes, which tells nothing of its source.
pub fn stimulus_name(bytes: &[u8]) -> String {
    format!("{}.png", hex(&Sha256::digest(bytes)[..12]))
}

fn is_stimulus_name(name: &str) -> bool {
    name.strip_suffix(".png")
        .is_some_and(|stem| stem.len() == 24 && stem.bytes().all(|byte| byte.is_ascii_hexdigit()))
}

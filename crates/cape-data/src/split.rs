use std::{
    collections::{BTreeMap, HashMap, HashSet},
    fs,
    path::{Component, Path, PathBuf},
};

use cape_core::{Outfit, OutfitVocabulary};
use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Selection of the training and test frames of a raw tree, and their packing order.
///
/// As TOML (`split.toml`):
///
/// ```toml
/// subjects = ["00032", "00122"]
/// outfits = ["shortlong", "longlong", "poloshort"]
/// cut = 2          # frames dropped at either end of a sequence (default 2)
/// sample_rate = 1  # keep every n-th of the remaining frames (default 1)
/// body = "body_male.npz"  # the subjects' body in the raw data (default body.npz)
/// mirror = true    # pack training frames a second time, left and right exchanged (default false)
///
/// [labels]         # outfits that are packed under the label of another
/// poloshort = "shortshort"
///
/// [train]
/// sequences = ["hips", "squats", "simple"]
/// exclude = ["simple", "00032/longlong_hips"]
///
/// [test]
/// sequences = ["soccer"]
///
/// [validation]     # whole captures in place of the last training frames
/// sequences = ["move_arms"]
/// ```
///
/// ```
/// use cape_core::Outfit;
/// use cape_data::SplitSpec;
///
/// let split = SplitSpec::preset("male")?;
/// assert_eq!((split.subjects.len(), split.test.sequences.len()), (7, 4));
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("split.toml");
/// std::fs::write(&path, split.to_toml()?)?;
/// assert_eq!(SplitSpec::from_file(&path)?, split);
///
/// let mut twice = split;
/// twice.outfits = vec![Outfit::LONG_LONG; 2];
/// assert!(twice.validate().is_err());
///
/// // Labels are the paper's four, unless there are others.
/// let mut more = SplitSpec { outfits: vec!["poloshort".parse()?], ..SplitSpec::male() };
/// assert_eq!(more.label_vocabulary()?.to_string(), "poloshort");
/// more.labels.insert("poloshort".parse()?, Outfit::SHORT_SHORT);
/// assert!(more.label_vocabulary()?.is_paper());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplitSpec {
    /// Subjects, in packing order.
    pub subjects: Vec<String>,
    /// Outfits, in packing order: the first part of the captures' directory names.
    pub outfits: Vec<Outfit>,
    /// Outfits of the one-hot labels, in their order; `None` takes the paper's four if all labels are
    /// among them, or else the labels in packing order.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vocabulary: Option<OutfitVocabulary>,
    /// Number of frames dropped at the beginning and at the end of every sequence.
    #[serde(default = "default_cut")]
    pub cut: usize,
    /// Step between the frames kept after `cut`, from the first on.
    #[serde(default = "default_sample_rate")]
    pub sample_rate: usize,
    /// File of the subjects' body, relative to the raw data; `None` is `body.npz`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body: Option<PathBuf>,
    /// Packs every training frame a second time as its mirror image about the body's plane of symmetry,
    /// which doubles the training data. Needs the body, and validation sequences.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub mirror: bool,
    /// Outfits that are packed under the label of another, such as `poloshort = "shortshort"`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub labels: BTreeMap<Outfit, Outfit>,
    /// Training sequences.
    pub train: SequenceList,
    /// Test sequences.
    #[serde(default)]
    pub test: SequenceList,
    /// Validation sequences, packed after the training frames. Without them the last training frames are
    /// for validation, [`validation_count`](crate::validation_count) of them, as in the release.
    #[serde(default, skip_serializing_if = "SequenceList::is_empty")]
    pub validation: SequenceList,
}

/// Motion sequences, in packing order, and exclusions from them.
///
/// ```
/// use cape_core::Outfit;
/// use cape_data::SequenceList;
///
/// let list = SequenceList {
///     sequences: vec!["hips".into(), "simple".into()],
///     exclude: vec!["simple".into(), "00032/longlong_hips".into()],
/// };
/// assert!(list.excludes("00122", Outfit::LONG_LONG, "simple"));
/// assert!(list.excludes("00032", Outfit::LONG_LONG, "hips"));
/// assert!(!list.excludes("00122", Outfit::LONG_LONG, "hips"));
/// ```
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SequenceList {
    /// Names without the outfit, such as `soccer`.
    pub sequences: Vec<String>,
    /// Excluded sequences (`soccer`) and captures (`00032/longlong_soccer`).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub exclude: Vec<String>,
}

impl SequenceList {
    /// True if there is no sequence.
    pub fn is_empty(&self) -> bool {
        self.sequences.is_empty() && self.exclude.is_empty()
    }

    /// True if `exclude` has this capture or its whole sequence.
    pub fn excludes(&self, subject: &str, outfit: Outfit, sequence: &str) -> bool {
        let capture = format!("{subject}/{outfit}_{sequence}");
        self.exclude.iter().any(|name| name == sequence || *name == capture)
    }
}

const fn default_cut() -> usize {
    2
}

const fn default_sample_rate() -> usize {
    1
}

const MALE: &[&str] = &["03284", "00215", "00127", "00122", "00032", "02474", "03394"];
const FEMALE: &[&str] = &["00159", "00134", "03223", "03331"];
const OUTFITS: [Outfit; 4] =
    [Outfit::SHORT_LONG, Outfit::LONG_SHORT, Outfit::SHORT_SHORT, Outfit::LONG_LONG];
const GROUP_1: &[&str] = &[
    "ballerina_spin",
    "ATUsquat",
    "basketball",
    "bend_back_and_front",
    "bend_twist",
    "chicken_wings",
    "flying_eagle",
    "hips",
    "improvise",
    "jumping_jacks",
    "move_arms",
    "move_shoulders",
    "pose_model",
    "punching",
    "ROM_lower",
    "ROM_upper",
    "rotate_hips",
    "running_on_the_spot",
    "shoulders_mill",
    "simple",
    "soccer",
    "squats",
    "twist_tilt",
    "tilt_twist_left",
    "twist_tilt_left",
    "walk_march",
];
const GROUP_1_TEST: &[&str] = &["ballerina_spin", "soccer", "pose_model", "bend_twist"];
const GROUP_2_TRAIN: &[&str] = &[
    "athletics",
    "ATUsquat",
    "badminton",
    "basketball",
    "ballet1",
    "box",
    "frisbee",
    "golf",
    "row",
    "swim",
    "twist_tilt",
    "volleyball",
    "climb",
    "ski",
];
const GROUP_2_TEST: &[&str] = &["twist_trial2", "soccer_trial2", "climb_trial2", "ski_trial2"];
/// Sequences with too much soft-tissue and cloth dynamics for a model of single frames.
const TOO_DYNAMIC: &[&str] = &["running_on_the_spot", "jumping_jacks"];

impl Default for SplitSpec {
    /// No subjects and sequences; the paper's outfits, all frames but two at either end.
    fn default() -> Self {
        Self {
            subjects: Vec::new(),
            outfits: Outfit::PAPER.to_vec(),
            vocabulary: None,
            cut: default_cut(),
            sample_rate: default_sample_rate(),
            body: None,
            mirror: false,
            labels: BTreeMap::new(),
            train: SequenceList::default(),
            test: SequenceList::default(),
            validation: SequenceList::default(),
        }
    }
}

fn owned(names: &[&str]) -> Vec<String> {
    names.iter().map(ToString::to_string).collect()
}

impl SplitSpec {
    /// The paper's male set: seven subjects, four held-out sequences.
    pub fn male() -> Self {
        let train = GROUP_1.iter().filter(|name| !GROUP_1_TEST.contains(name));
        Self {
            subjects: owned(MALE),
            outfits: OUTFITS.to_vec(),
            train: SequenceList {
                sequences: train.map(ToString::to_string).collect(),
                exclude: owned(TOO_DYNAMIC),
            },
            test: SequenceList { sequences: owned(GROUP_1_TEST), exclude: Vec::new() },
            ..Self::default()
        }
    }

    /// The paper's female set: four subjects, the sequences of the male set and those of a second
    /// capture session.
    pub fn female() -> Self {
        let mut split = Self { subjects: owned(FEMALE), ..Self::male() };
        split.train.sequences.extend(GROUP_2_TRAIN.iter().map(|name| format!("{name}_trial1")));
        split.test.sequences.extend(owned(GROUP_2_TEST));
        split
    }

    /// The preset called `name`: `male` or `female`.
    pub fn preset(name: &str) -> Result<Self> {
        match name {
            "male" => Ok(Self::male()),
            "female" => Ok(Self::female()),
            _ => Err(Error::argument(format!("unknown split `{name}`: expected male or female"))),
        }
    }

    /// Reads a `split.toml` file and checks it.
    pub fn from_file(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let text = fs::read_to_string(path).map_err(|e| Error::io(path, e))?;
        let split: Self =
            toml::from_str(&text).map_err(|e| Error::format(path, e.to_string().trim_end()))?;
        split.check().map_err(|(field, message)| Error::field(path, field, message))?;
        Ok(split)
    }

    /// Label of the captures of an outfit: another outfit by `labels`, or the outfit itself.
    pub fn label(&self, outfit: Outfit) -> Outfit {
        self.labels.get(&outfit).copied().unwrap_or(outfit)
    }

    /// Outfits of the one-hot labels, in their order.
    ///
    /// # Errors
    /// If there is none, or a label is not in the given vocabulary.
    pub fn label_vocabulary(&self) -> Result<OutfitVocabulary> {
        let labels = || self.outfits.iter().map(|&outfit| self.label(outfit));
        if let Some(vocabulary) = &self.vocabulary {
            labels().try_for_each(|label| vocabulary.require(label).map(drop))?;
            return Ok(vocabulary.clone());
        }
        let paper = OutfitVocabulary::default();
        if labels().all(|label| paper.contains(&label)) {
            return Ok(paper);
        }
        let mut seen = HashSet::new();
        OutfitVocabulary::new(labels().filter(|&label| seen.insert(label)))
    }

    /// Contents of a `split.toml` file.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string_pretty(self).map_err(|e| Error::argument(format!("split: {e}")))
    }

    /// Checks that the split selects at least one sequence, and nothing twice; errors name the
    /// field.
    pub fn validate(&self) -> Result<()> {
        self.check()
            .map_err(|(field, message)| Error::argument(format!("split: `{field}`: {message}")))
    }

    fn check(&self) -> Result<(), (&'static str, String)> {
        check_names("subjects", &self.subjects)?;
        check_names("train.sequences", &self.train.sequences)?;
        check_names("test.sequences", &self.test.sequences)?;
        check_names("validation.sequences", &self.validation.sequences)?;
        for (field, empty) in [
            ("subjects", self.subjects.is_empty()),
            ("outfits", self.outfits.is_empty()),
            ("train.sequences", self.train.sequences.is_empty() && self.test.sequences.is_empty()),
        ] {
            if empty {
                return Err((field, "is empty: expected at least one name".to_owned()));
            }
        }
        let distinct: HashSet<_> = self.outfits.iter().collect();
        if distinct.len() != self.outfits.len() {
            return Err(("outfits", "an outfit is listed twice".to_owned()));
        }
        if let Some(outfit) = self.labels.keys().find(|outfit| !self.outfits.contains(outfit)) {
            return Err(("labels", format!("`{outfit}` is not in `outfits`")));
        }
        if let Err(error) = self.label_vocabulary() {
            return Err(("vocabulary", error.to_string()));
        }
        if self.sample_rate == 0 {
            return Err(("sample_rate", "is 0: expected 1 (every frame) or more".to_owned()));
        }
        if self.mirror && self.validation.is_empty() {
            return Err((
                "mirror",
                "needs `validation.sequences`: the last training frames would be mirror images of \
                 others"
                    .to_owned(),
            ));
        }
        let plain = |path: &PathBuf| {
            path.components().next().is_some()
                && path.components().all(|part| matches!(part, Component::Normal(_)))
        };
        if let Some(body) = self.body.as_ref().filter(|body| !plain(body)) {
            let body = body.display();
            return Err((
                "body",
                format!("`{body}`: expected the path of a file below the raw data"),
            ));
        }
        for (field, list) in [
            ("train.exclude", &self.train),
            ("test.exclude", &self.test),
            ("validation.exclude", &self.validation),
        ] {
            if let Some(name) = list.exclude.iter().find(|name| !self.selects(list, name)) {
                return Err((
                    field,
                    format!(
                        "`{name}`: expected a sequence of the list, or `subject/outfit_sequence` of \
                         one"
                    ),
                ));
            }
        }
        let mut lists = HashMap::new();
        for (field, list) in [
            ("train.sequences", &self.train),
            ("test.sequences", &self.test),
            ("validation.sequences", &self.validation),
        ] {
            for name in &list.sequences {
                if let Some(other) = lists.insert(name, field) {
                    return Err((field, format!("`{name}` is also in `{other}`")));
                }
            }
        }
        Ok(())
    }

    /// True if `name` is a sequence of `list` or one capture of it.
    fn selects(&self, list: &SequenceList, name: &str) -> bool {
        let (subject, capture) = name.split_once('/').unwrap_or(("", name));
        let Some((outfit, sequence)) = capture.split_once('_').filter(|_| name.contains('/'))
        else {
            return list.sequences.iter().any(|sequence| sequence == name);
        };
        self.subjects.iter().any(|known| known == subject)
            && self.outfits.iter().any(|known| known.name() == outfit)
            && list.sequences.iter().any(|known| known == sequence)
    }
}

/// Checks names, which become directory names and fields of CSV files.
fn check_names(field: &'static str, names: &[String]) -> Result<(), (&'static str, String)> {
    let mut seen = HashSet::new();
    for name in names {
        let plain = |c: char| c.is_alphanumeric() || matches!(c, '_' | '-' | '.' | '+' | ' ');
        if name.is_empty() || name.starts_with('.') || !name.chars().all(plain) {
            return Err((
                field,
                format!(
                    "`{name}`: expected a name of letters, digits, `_`, `-`, `.`, `+` and spaces"
                ),
            ));
        }
        if !seen.insert(name) {
            return Err((field, format!("lists `{name}` twice")));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn minimal(extra: &str) -> String {
        format!(
            "{extra}\nsubjects = ['a']\noutfits = ['shortlong']\n[train]\nsequences = ['walk']\n"
        )
    }

    fn load(text: &str) -> Result<SplitSpec> {
        let file = tempfile::NamedTempFile::new().unwrap();
        fs::write(file.path(), text).unwrap();
        SplitSpec::from_file(file.path())
    }

    #[test]
    fn presets_have_the_papers_sizes_and_order() {
        let male = SplitSpec::male();
        assert_eq!(male.subjects.first().map(String::as_str), Some("03284"));
        assert_eq!((male.subjects.len(), male.train.sequences.len()), (7, 22));
        assert_eq!(male.train.sequences[..2], ["ATUsquat", "basketball"]);
        assert_eq!(male.test.sequences, ["ballerina_spin", "soccer", "pose_model", "bend_twist"]);
        assert!(male.train.excludes("00032", Outfit::LONG_LONG, "jumping_jacks"));
        let female = SplitSpec::female();
        assert_eq!(female.subjects, ["00159", "00134", "03223", "03331"]);
        assert_eq!((female.train.sequences.len(), female.test.sequences.len()), (36, 8));
        assert_eq!(female.train.sequences[22], "athletics_trial1");
        for split in [male, female] {
            split.validate().unwrap();
            assert_eq!((split.cut, split.sample_rate), (2, 1));
        }
    }

    #[test]
    fn toml_round_trip_and_defaults() {
        let split = SplitSpec::female();
        assert_eq!(load(&split.to_toml().unwrap()).unwrap(), split);
        let split = SplitSpec { body: Some("body_female.npz".into()), ..split };
        assert_eq!(load(&split.to_toml().unwrap()).unwrap(), split);
        let split = load(&minimal("")).unwrap();
        assert_eq!((split.cut, split.sample_rate, split.test.sequences.len()), (2, 1, 0));
    }

    #[test]
    fn labels_are_in_the_vocabulary() {
        let outfits = |text: &str| swap_outfits(text).label_vocabulary().unwrap().to_string();
        let paper = OutfitVocabulary::default().to_string();
        assert_eq!(outfits("['longlong']"), paper);
        assert_eq!(outfits("['polo', 'shortlong']"), "polo, shortlong");
        assert_eq!(outfits("['polo', 'shortlong']\nlabels = { polo = 'longlong' }"), paper);
        let order = "['polo', 'shortlong']\nvocabulary = ['shortlong', 'coat', 'polo']";
        assert_eq!(outfits(order), "shortlong, coat, polo");
        let split = swap_outfits("['polo', 'jersey']\nlabels = { polo = 'jersey' }");
        assert_eq!(split.label_vocabulary().unwrap().to_string(), "jersey");
        assert_eq!(load(&split.to_toml().unwrap()).unwrap(), split);
        // Files and presets without the fields are written as before.
        let text = SplitSpec::male().to_toml().unwrap();
        assert!(
            !["vocabulary", "labels", "body", "validation"]
                .iter()
                .any(|field| text.contains(field)),
            "{text}"
        );
    }

    fn swap_outfits(text: &str) -> SplitSpec {
        load(&minimal("").replace("['shortlong']", text)).unwrap()
    }

    #[test]
    fn exclusions_name_a_sequence_or_one_capture() {
        let list = SequenceList {
            sequences: owned(&["hips", "walk"]),
            exclude: owned(&["walk", "a/longlong_hips"]),
        };
        assert!(list.excludes("b", Outfit::SHORT_LONG, "walk"));
        assert!(list.excludes("a", Outfit::LONG_LONG, "hips"));
        assert!(!list.excludes("b", Outfit::LONG_LONG, "hips"));
    }

    #[test]
    fn mistakes_are_named() {
        let swap = |from: &str, to: &str| minimal("").replace(from, to);
        for (text, expected) in [
            (minimal("cats = 1"), "cats"),
            (minimal("cut = -1"), "cut"),
            (minimal("sample_rate = 0"), "`sample_rate`"),
            (minimal("body = '../body.npz'"), "`body`: `../body.npz`"),
            (minimal("body = '/body.npz'"), "`body`"),
            (minimal("body = ''"), "`body`"),
            (swap("subjects = ['a']", ""), "subjects"),
            (swap("['a']", "[]"), "`subjects`: is empty"),
            (swap("['a']", "['a', 'a']"), "`subjects`: lists `a` twice"),
            (swap("['a']", "['../a']"), "`subjects`: `../a`: expected a name"),
            (swap("['shortlong']", "['long_coat']"), "outfit `long_coat`: expected a name"),
            (minimal("vocabulary = ['longlong']"), "`vocabulary`: unknown outfit `shortlong`"),
            (minimal("vocabulary = []"), "the list is empty"),
            (minimal("") + "[labels]\npolo = 'longlong'", "`labels`: `polo` is not in `outfits`"),
            (swap("['shortlong']", "['longlong', 'longlong']"), "`outfits`"),
            (swap("['walk']", "[]"), "`train.sequences`"),
            (minimal("") + "exclude = ['wakl']", "`train.exclude`: `wakl`"),
            (minimal("") + "exclude = ['a/longlong_walk']", "`train.exclude`"),
            (minimal("") + "[test]\nsequences = ['walk']", "`test.sequences`: `walk` is also"),
            (
                minimal("") + "[validation]\nsequences = ['walk']",
                "`validation.sequences`: `walk` is also in `train.sequences`",
            ),
            (
                minimal("") + "[validation]\nsequences = ['run']\nexclude = ['walk']",
                "`validation.exclude`: `walk`",
            ),
        ] {
            let message = load(&text).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
        load(&(minimal("") + "exclude = ['walk', 'a/shortlong_walk']")).unwrap();
        assert!(SplitSpec::from_file("/nonexistent/split.toml").is_err());
        assert!(SplitSpec::preset("child").unwrap_err().to_string().contains("child"));
    }
}

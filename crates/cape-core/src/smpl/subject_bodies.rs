use std::{collections::BTreeMap, fs, path::Path};

use super::{Gender, SmplModel};
use crate::{Error, Result, pickle::write_texts};

/// Name of the file of the body of all subjects in a data set.
pub const BODY_FILE: &str = "body.npz";

/// Bodies of the subjects of a data set: one for all of them, or male and female ones.
///
/// ```
/// use cape_core::smpl::{Gender, SubjectBodies};
/// use cape_synth::synthetic_body;
///
/// let body = synthetic_body();
/// assert!(SubjectBodies::from(&body).of(None).is_ok());
/// let both = SubjectBodies::Genders { male: &body, female: &body };
/// assert!(both.of(Some(Gender::Female)).is_ok());
/// assert!(both.of(None).is_err());
/// assert_eq!(both.file_name(Some(Gender::Male)), "body_male.npz");
/// ```
#[derive(Debug, Clone, Copy)]
pub enum SubjectBodies<'a> {
    /// One body for all subjects.
    One(&'a SmplModel),
    /// Bodies by gender.
    Genders {
        /// Body of the male subjects.
        male: &'a SmplModel,
        /// Body of the female subjects.
        female: &'a SmplModel,
    },
}

impl<'a> From<&'a SmplModel> for SubjectBodies<'a> {
    fn from(body: &'a SmplModel) -> Self {
        Self::One(body)
    }
}

impl<'a> SubjectBodies<'a> {
    /// Body of a subject of the given gender.
    ///
    /// # Errors
    /// If there are bodies by gender, and none of this gender.
    pub fn of(self, gender: Option<Gender>) -> Result<&'a SmplModel> {
        match (self, gender) {
            (Self::One(body), _) => Ok(body),
            (Self::Genders { male, .. }, Some(Gender::Male)) => Ok(male),
            (Self::Genders { female, .. }, Some(Gender::Female)) => Ok(female),
            (Self::Genders { .. }, Some(Gender::Neutral)) => {
                Err(Error::Argument("gender neutral: expected male or female".into()))
            }
            (Self::Genders { .. }, None) => {
                Err(Error::Argument("unknown gender: expected male or female".into()))
            }
        }
    }

    /// Name of the file of that body in a raw data set.
    pub fn file_name(self, gender: Option<Gender>) -> &'static str {
        match (self, gender) {
            (Self::Genders { .. }, Some(gender)) => gender.body_file(),
            _ => BODY_FILE,
        }
    }
}

impl Gender {
    /// Name of the file of the body of the subjects of this gender in a raw data set.
    pub const fn body_file(self) -> &'static str {
        match self {
            Self::Male => "body_male.npz",
            Self::Female => "body_female.npz",
            Self::Neutral => "body_neutral.npz",
        }
    }
}

/// File of the subjects' genders in a raw data set, where the CAPE release has it.
pub const GENDERS_FILE: &str = "misc/subj_genders.pkl";

/// Writes the genders of the subjects of the raw data set in `root` as the CAPE release has them.
///
/// # Errors
/// If the file cannot be written.
pub fn write_genders(root: &Path, genders: &BTreeMap<String, Gender>) -> Result<()> {
    let path = root.join(GENDERS_FILE);
    if let Some(directory) = path.parent() {
        fs::create_dir_all(directory).map_err(|source| Error::io(directory, source))?;
    }
    let texts: Vec<(&str, String)> =
        genders.iter().map(|(name, gender)| (name.as_str(), gender.to_string())).collect();
    write_texts(path, texts.iter().map(|(name, gender)| (*name, gender.as_str())))
}

//! Bodies of commands: built-in ones by name, and files in SMPL's layout.

use std::{
    env, fmt,
    path::{Path, PathBuf},
};

use cape_core::{
    SmplModel,
    smpl::{BODY_FILE, Gender, SubjectBodies, find_body},
};
use cape_eval::store::StoreSettings;
use cape_layer::BodyIdentity;
use cape_synth::{BODY_VERTICES, HalfBody, embedded_body, synthetic_body};
use clap::Args;
use serde::{Deserialize, Serialize};

use crate::{
    error::{Error, Result},
    options::choices,
};

/// Variable with the directory of SMPL's bodies.
const MODELS: &str = "SMPL_MODELS";

/// Genders by name.
pub(crate) const GENDERS: [(&str, Gender); 3] =
    [("male", Gender::Male), ("female", Gender::Female), ("neutral", Gender::Neutral)];

/// Largest sum of the vertices' x of a mirror-symmetric body, metres.
const SYMMETRIC: f64 = 1e-6;

/// A body model.
#[derive(Debug, Clone, PartialEq, Args, Serialize, Deserialize)]
pub(crate) struct BodyModelArgs {
    /// Built-in body (male, female, neutral or sculpted), SMPL body (.pkl or .npz), or with --gender
    /// the directory of one [default: neutral].
    #[arg(long, value_name = "BODY")]
    body: Option<PathBuf>,
    /// Gender of the body in the directory of --body, or in $SMPL_MODELS without --body.
    #[arg(long, value_name = "GENDER", value_parser = choices(GENDERS))]
    #[serde(skip)]
    gender: Option<Gender>,
}

/// A body for data that have none of their own.
#[derive(Debug, Clone, Args)]
pub(crate) struct BodyFileArgs {
    /// Built-in body (male, female, neutral or sculpted), SMPL body (.pkl or .npz), or with --gender
    /// the directory of one, if the data have no body.npz.
    #[arg(long, value_name = "BODY")]
    body: Option<PathBuf>,
    /// Gender of the body in the directory of --body, or in $SMPL_MODELS without --body.
    #[arg(long, value_name = "GENDER", value_parser = choices(GENDERS))]
    gender: Option<Gender>,
}

/// Bodies of the subjects of a data set.
#[derive(Debug, Clone, Args)]
pub(crate) struct SubjectBodyArgs {
    /// Body of all subjects: built in (male, female, neutral or sculpted), an SMPL body (.pkl or
    /// .npz), or with --gender one of a directory; a directory without --gender gives its male and
    /// female bodies [default: male and female, built in].
    #[arg(long, value_name = "BODY")]
    body: Option<PathBuf>,
    /// Gender of the body in the directory of --body, or in $SMPL_MODELS without --body.
    #[arg(long, value_name = "GENDER", value_parser = choices(GENDERS))]
    gender: Option<Gender>,
}

/// A body that is part of the program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum BuiltinBody {
    /// A human body.
    Human(Gender),
    /// The body that is sculpted from distance functions.
    Sculpted,
}

/// A body of the program or a file of one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum BodySource {
    Builtin(BuiltinBody),
    File(PathBuf),
}

/// Bodies of a data set's subjects: one for all, or male and female ones.
#[derive(Debug)]
pub(crate) enum SubjectModels {
    One(Box<SmplModel>),
    Genders { male: Box<SmplModel>, female: Box<SmplModel> },
}

impl BodyModelArgs {
    /// The body that is asked for, or the neutral one.
    pub(crate) fn source(&self) -> Result<BodySource> {
        let given = source(self.body.as_deref(), self.gender)?;
        Ok(given.unwrap_or(BodySource::Builtin(BuiltinBody::Human(Gender::Neutral))))
    }

    pub(crate) fn load(&self) -> Result<SmplModel> {
        self.source()?.load()
    }

    /// True if a body is asked for.
    #[cfg(feature = "view")]
    pub(crate) fn is_given(&self) -> bool {
        self.body.is_some() || self.gender.is_some()
    }
}

impl BodyFileArgs {
    /// The body, if one is asked for.
    pub(crate) fn load(&self) -> Result<Option<SmplModel>> {
        source(self.body.as_deref(), self.gender)?.map(|source| source.load()).transpose()
    }
}

impl SubjectBodyArgs {
    /// The bodies that are asked for, or the built-in male and female ones.
    pub(crate) fn load(&self) -> Result<SubjectModels> {
        let given = SubjectModels::given(self.body.as_deref(), self.gender)?;
        given.map_or_else(|| SubjectModels::of_genders(|gender| Ok(embedded_body(gender)?)), Ok)
    }
}

impl SubjectModels {
    /// The bodies of --body and --gender; `None` if neither is given.
    pub(crate) fn given(body: Option<&Path>, gender: Option<Gender>) -> Result<Option<Self>> {
        match body.filter(|path| gender.is_none() && path.is_dir()) {
            Some(path) => {
                Self::of_genders(|gender| Ok(SmplModel::load(find_body(path, gender)?)?)).map(Some)
            }
            None => source(body, gender)?.map(|source| source.load().map(Self::one)).transpose(),
        }
    }

    /// The bodies of a raw data set of one or two genders; `None` if it has none.
    pub(crate) fn of_data(raw: &Path) -> Result<Option<Self>> {
        let there = |name: &str| Some(raw.join(name)).filter(|path| path.is_file());
        let [male, female] = [Gender::Male, Gender::Female].map(|gender| there(gender.body_file()));
        match (there(BODY_FILE), male, female) {
            (None, Some(male), Some(female)) => Self::of_genders(|gender| {
                Ok(SmplModel::load(if gender == Gender::Male { &male } else { &female })?)
            })
            .map(Some),
            (one, male, female) => {
                let path = one.or(male).or(female);
                path.map(|path| Ok(Self::one(SmplModel::load(path)?))).transpose()
            }
        }
    }

    fn one(body: SmplModel) -> Self {
        Self::One(Box::new(body))
    }

    fn of_genders(load: impl Fn(Gender) -> Result<SmplModel>) -> Result<Self> {
        let (male, female) = (load(Gender::Male)?, load(Gender::Female)?);
        Ok(Self::Genders { male: Box::new(male), female: Box::new(female) })
    }

    pub(crate) fn bodies(&self) -> SubjectBodies<'_> {
        match self {
            Self::One(body) => SubjectBodies::One(body),
            Self::Genders { male, female } => SubjectBodies::Genders { male, female },
        }
    }
}

/// The body of --body and --gender; `None` if neither is given.
fn source(body: Option<&Path>, gender: Option<Gender>) -> Result<Option<BodySource>> {
    let file = match (body, gender) {
        (None, None) => return Ok(None),
        (Some(path), None) if path.is_dir() => {
            return Err(Error::message(format!(
                "{}: is a directory: choose a body in it by --gender male, female or neutral",
                path.display()
            )));
        }
        (Some(path), None) => match BuiltinBody::named(path) {
            Some(body) => return Ok(Some(BodySource::Builtin(body))),
            None => path.to_owned(),
        },
        (Some(path), Some(gender)) if path.is_dir() => find_body(path, gender)?,
        (Some(path), Some(_)) => {
            return Err(Error::message(format!(
                "{}: --gender chooses a body in a directory, and this is none",
                path.display()
            )));
        }
        (None, Some(gender)) => match env::var_os(MODELS) {
            Some(directory) => find_body(PathBuf::from(directory), gender)?,
            None => {
                return Err(Error::message(format!(
                    "--gender {gender}: give the directory of SMPL's bodies by --body or ${MODELS}, \
                     or take the built-in body by --body {gender}"
                )));
            }
        },
    };
    Ok(Some(BodySource::File(file)))
}

impl BuiltinBody {
    const ALL: [Self; 4] = [
        Self::Human(Gender::Male),
        Self::Human(Gender::Female),
        Self::Human(Gender::Neutral),
        Self::Sculpted,
    ];

    /// The body of that name, if no such file exists.
    pub(crate) fn named(path: &Path) -> Option<Self> {
        let name = path.to_str().filter(|_| !path.exists())?;
        Self::ALL.into_iter().find(|body| body.to_string() == name)
    }

    /// The body that has these arrays, if there is one.
    pub(crate) fn of(model: &SmplModel) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|body| body.may_be(model) && body.load().is_ok_and(|own| own == *model))
    }

    /// False if a quick comparison tells `model` apart.
    fn may_be(self, model: &SmplModel) -> bool {
        match self {
            Self::Human(gender) => HalfBody::embedded(gender).is_ok_and(|half| {
                let rows = model.v_template.rows();
                half.vertices.iter().zip(rows).all(|(own, row)| own.to_array()[..] == row.to_vec())
            }),
            // It takes a second to sculpt.
            Self::Sculpted => {
                let sum = model.v_template.column(0).sum();
                model.vertices() == BODY_VERTICES && sum.abs() < SYMMETRIC
            }
        }
    }

    pub(crate) fn load(self) -> Result<SmplModel> {
        match self {
            Self::Human(gender) => Ok(embedded_body(gender)?),
            Self::Sculpted => Ok(synthetic_body()),
        }
    }

    /// Source and licence of the data.
    pub(crate) fn provenance(self) -> Result<String> {
        match self {
            Self::Human(gender) => Ok(HalfBody::embedded(gender)?.provenance),
            Self::Sculpted => Ok("sculpted from distance functions by this program".to_owned()),
        }
    }
}

impl fmt::Display for BuiltinBody {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Human(gender) => gender.fmt(f),
            Self::Sculpted => f.pad("sculpted"),
        }
    }
}

impl BodySource {
    pub(crate) fn load(&self) -> Result<SmplModel> {
        match self {
            Self::Builtin(body) => body.load(),
            Self::File(path) => Ok(SmplModel::load(path)?),
        }
    }

    /// Identity of the loaded body, for what belongs to it.
    pub(crate) fn identity(&self, model: &SmplModel) -> BodyIdentity {
        let name = match self {
            Self::Builtin(body) => format!("{body} (built in)"),
            Self::File(path) => {
                path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
            }
        };
        BodyIdentity::new(name, model)
    }

    /// The settings with this body as the input `body`.
    pub(crate) fn input_of(&self, settings: StoreSettings) -> Result<StoreSettings> {
        Ok(match self {
            Self::Builtin(body) => settings.with_built_in("body", &body.to_string()),
            Self::File(path) => settings.with_input("body", path)?,
        })
    }
}

/// Description of a body: the name of a built-in one, or size and the begin of its SHA-256.
pub(crate) fn describe(model: &SmplModel) -> String {
    match BuiltinBody::of(model) {
        Some(body) => format!("{body} (built in)"),
        None => format!("{} vertices, SHA-256 {}", model.vertices(), &model.sha256()[..12]),
    }
}

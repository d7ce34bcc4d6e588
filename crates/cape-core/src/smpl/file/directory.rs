//! Bodies in the directories in which other programs keep them.

use std::{
    fs,
    path::{Path, PathBuf},
};

use crate::{Error, Result, smpl::Gender};

/// Finds SMPL's body of a gender in a directory: `SMPL_MALE.npz` or `.pkl` as smplx has it,
/// `basicModel_m_lbs_10_207_0_v1.0.0.pkl` as SMPL's own site, or `male/model.npz` as
/// human_body_prior, in the directory itself or in `smpl/`, `models/` or `smpl/models/` below it.
/// Letters may be large or small; `.npz` is preferred.
///
/// ```
/// use cape_core::smpl::{Gender, find_body};
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("smpl/SMPL_FEMALE.pkl");
/// std::fs::create_dir(directory.path().join("smpl"))?;
/// std::fs::write(&path, "")?;
/// assert_eq!(find_body(directory.path(), Gender::Female)?, path);
/// let error = find_body(directory.path(), Gender::Male).unwrap_err();
/// assert!(error.to_string().contains("SMPL_MALE"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// If there is none; the error lists the names that are looked for.
pub fn find_body(directory: impl AsRef<Path>, gender: Gender) -> Result<PathBuf> {
    let directory = directory.as_ref();
    let letter = match gender {
        Gender::Male => "m",
        Gender::Female => "f",
        Gender::Neutral => "neutral",
    };
    let prefixes = [format!("smpl_{gender}"), format!("basicmodel_{letter}_lbs_10_207_0_v")];
    let mut found = Vec::new();
    for below in ["", "smpl", "models", "smpl/models"] {
        let place = if below.is_empty() { directory.to_owned() } else { directory.join(below) };
        for (path, name) in entries(&place)? {
            let (stem, extension) = name.rsplit_once('.').unwrap_or((&name, ""));
            let plain = stem == prefixes[0] || stem.starts_with(&prefixes[1]);
            if plain && matches!(extension, "npz" | "pkl") {
                found.push(path);
            } else if name == gender.to_string() && path.is_dir() {
                let inner = entries(&path)?.into_iter();
                found.extend(
                    inner
                        .filter(|(_, name)| matches!(name.as_str(), "model.npz" | "model.pkl"))
                        .map(|(path, _)| path),
                );
            }
        }
        let preferred = found.iter().position(|path| path.extension().is_some_and(|e| e == "npz"));
        if let Some(path) = found.get(preferred.unwrap_or(0)) {
            return Ok(path.clone());
        }
    }
    let upper = gender.to_string().to_uppercase();
    Err(Error::Argument(format!(
        "{}: no {gender} body of SMPL: expected SMPL_{upper}.npz or .pkl, \
         basicModel_{letter}_lbs_10_207_0_v1.0.0.pkl or {gender}/model.npz, there or in smpl/ or models/",
        directory.display()
    )))
}

/// Entries of a directory with their names in small letters, by name; none if there is no directory.
fn entries(directory: &Path) -> Result<Vec<(PathBuf, String)>> {
    if !directory.is_dir() {
        return Ok(Vec::new());
    }
    let fail = |source| Error::io(directory, source);
    let mut found = Vec::new();
    for entry in fs::read_dir(directory).map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        found.push((path, name));
    }
    found.sort();
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bodies_are_found_where_other_programs_keep_them() {
        let layouts = [
            (Gender::Male, "smpl/SMPL_MALE.pkl"),
            (Gender::Neutral, "SMPL_NEUTRAL.npz"),
            (Gender::Male, "basicModel_m_lbs_10_207_0_v1.0.0.pkl"),
            (Gender::Female, "models/basicmodel_f_lbs_10_207_0_v1.1.0.pkl"),
            (Gender::Neutral, "smpl/models/basicModel_neutral_lbs_10_207_0_v1.0.0.pkl"),
            (Gender::Female, "female/model.npz"),
        ];
        for (gender, name) in layouts {
            let root = tempfile::tempdir().unwrap();
            let path = root.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, "").unwrap();
            assert_eq!(find_body(root.path(), gender).unwrap(), path);
            for other in [Gender::Male, Gender::Female, Gender::Neutral] {
                assert_eq!(find_body(root.path(), other).is_ok(), other == gender, "{name}");
            }
        }
        let root = tempfile::tempdir().unwrap();
        for name in ["SMPL_MALE.pkl", "SMPL_MALE.npz"] {
            fs::write(root.path().join(name), "").unwrap();
        }
        assert!(find_body(root.path(), Gender::Male).unwrap().ends_with("SMPL_MALE.npz"));
    }
}

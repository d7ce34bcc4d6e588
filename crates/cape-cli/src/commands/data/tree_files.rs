use std::path::Path;

use cape_core::smpl::Gender;
use cape_data::{
    SplitSpec,
    raw::{CLOTHING_FILE, SPLIT_FILE, gender_split_file},
};
use cape_synth::SubjectGroup;

use crate::{error::Result, files};

/// Files of a raw data set of one or two genders that its captures share.
pub(super) struct TreeFiles {
    names: Vec<&'static str>,
    genders: Vec<Gender>,
}

impl TreeFiles {
    /// Writes the split of the subjects with each body.
    pub(super) fn write_splits(
        out: &Path,
        groups: &[SubjectGroup<'_>],
        split: &SplitSpec,
    ) -> Result<Self> {
        let mut names = vec![CLOTHING_FILE];
        for group in groups {
            let (name, own) = match group.gender() {
                None => (SPLIT_FILE, split.clone()),
                Some(gender) => {
                    let subjects = group.subject_names();
                    let body = Some(group.body_file().into());
                    (gender_split_file(gender), SplitSpec { subjects, body, ..split.clone() })
                }
            };
            files::write_text(&out.join(name), &own.to_toml()?)?;
            names.extend([group.body_file(), name]);
        }
        Ok(Self { names, genders: groups.iter().filter_map(SubjectGroup::gender).collect() })
    }

    /// The files in `out`, of which `more` is one if it is not empty, and the next command.
    pub(super) fn text(&self, out: &Path, more: &str) -> String {
        let names = self.names.iter().copied().chain(Some(more).filter(|name| !name.is_empty()));
        let (names, out) = (names.collect::<Vec<_>>().join(", "), out.display());
        let next = match self.genders.first() {
            Some(gender) => format!("--preset {gender} --out {out}-{gender}"),
            None => format!("--out {out}-packed"),
        };
        format!(
            "{out}: {names}, sequences/, minimal_body_shape/\nnext: cape data pack {out} {next}"
        )
    }
}

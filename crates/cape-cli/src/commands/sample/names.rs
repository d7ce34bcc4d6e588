//! File names of sampled meshes.

use std::collections::HashSet;

use cape_core::Outfit;

use crate::error::{Error, Result};

/// Fields of a name.
#[derive(Debug, Clone, Copy)]
pub(super) struct NameFields<'a> {
    pub(super) outfit: Outfit,
    /// Index of the sample, from 0.
    pub(super) sample: usize,
    /// Index of the pose among `frames`, from 0.
    pub(super) frame: usize,
    pub(super) frames: usize,
    pub(super) pose: &'a str,
    pub(super) seed: u64,
}

/// `{outfit}_{sample}`, and `_{frame}` if a sample has several.
pub(super) fn default(fields: &NameFields) -> String {
    let frame = match fields.frames {
        1 => String::new(),
        _ => format!("_{:05}", fields.frame),
    };
    format!("{}_{:03}{frame}", fields.outfit, fields.sample + 1)
}

/// `template` with its fields filled in.
pub(super) fn fill(template: &str, fields: &NameFields) -> Result<String> {
    let mut name = String::new();
    let mut rest = template;
    while let Some((before, after)) = rest.split_once('{') {
        let (field, after) = after
            .split_once('}')
            .ok_or_else(|| Error::message(format!("--name {template}: `{{` without `}}`")))?;
        name.push_str(before);
        let value = match field {
            "outfit" => fields.outfit.to_string(),
            "sample" => format!("{:03}", fields.sample + 1),
            "frame" => format!("{:05}", fields.frame),
            "pose" => fields.pose.to_owned(),
            "seed" => fields.seed.to_string(),
            _ => {
                return Err(Error::message(format!(
                    "--name {template}: unknown field `{{{field}}}`: expected {{outfit}}, \
                     {{sample}}, {{frame}}, {{pose}} or {{seed}}"
                )));
            }
        };
        name += &value;
        rest = after;
    }
    name.push_str(rest);
    let plain = |c: char| c.is_alphanumeric() || "-_.+= ".contains(c);
    if name.is_empty() || name.starts_with('.') || !name.chars().all(plain) {
        return Err(Error::message(format!("--name {template}: `{name}` is not a file name")));
    }
    Ok(name)
}

/// Returns an error if two names are equal.
pub(super) fn require_distinct<'a>(names: impl Iterator<Item = &'a str>) -> Result {
    let mut seen = HashSet::new();
    for name in names {
        if !seen.insert(name) {
            return Err(Error::message(format!(
                "--name: several meshes would be named {name}: use {{outfit}}, {{sample}} and {{frame}}"
            )));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn templates_are_filled_and_checked() {
        let fields = NameFields {
            outfit: Outfit::LONG_LONG,
            sample: 4,
            frame: 7,
            frames: 9,
            pose: "walk",
            seed: 3,
        };
        assert_eq!(default(&fields), "longlong_005_00007");
        let name = fill("{pose}-{outfit}.{sample}_{frame}s{seed}", &fields).unwrap();
        assert_eq!(name, "walk-longlong.005_00007s3");
        for (template, expected) in [
            ("{cat}", "unknown field `{cat}`"),
            ("{outfit", "without"),
            ("../{outfit}", "not a file name"),
            ("a/b", "not a file name"),
            ("", "not a file name"),
        ] {
            let message = fill(template, &fields).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
        assert!(require_distinct(["a", "b"].into_iter()).is_ok());
        assert!(require_distinct(["a", "a"].into_iter()).is_err());
    }
}

//! People of a file: dictionaries and lists of people, frames, or frames of people.

use std::path::Path;

use ndarray::{Axis, concatenate};

use super::{
    clip::Clip,
    content::Entry,
    fields::{clips, has_pose, unnamed_clips},
    foreign::explanation,
    names::{Common, Fields, POSES},
};
use crate::{Error, Result, natural_order};

/// Names of the numbers of people in a frame.
const IDS: [&str; 5] = ["tid", "track_ids", "track_id", "id", "person_id"];

/// The clips of all people of a file, with their names.
pub(super) fn people(path: &Path, root: &Entry) -> Result<Vec<(String, Clip)>> {
    let reader = PeopleReader { path };
    let found = match root {
        Entry::Numbers(numbers) => {
            let clips = unnamed_clips(path, numbers)?.unwrap_or_default();
            numbered("", clips)
        }
        root => reader.search("", root, &Common::default())?,
    };
    if found.is_empty() {
        if let Some(explanation) = explanation(root) {
            return Err(Error::format(path, explanation));
        }
        return Err(Error::format(
            path,
            format!(
                "no poses found: expected `poses` [n, 72], [n, 24, 3], [n, 24, 3, 3], [n, 156] or \
                 [n, 165], or `global_orient` with `body_pose` of 63 or 69 numbers; the file has {}",
                root.describe()
            ),
        ));
    }
    Ok(found)
}

struct PeopleReader<'e> {
    path: &'e Path,
}

impl PeopleReader<'_> {
    fn search(&self, name: &str, entry: &Entry, common: &Common) -> Result<Vec<(String, Clip)>> {
        match entry {
            Entry::Map(fields) if has_pose(fields) => {
                Ok(numbered(name, clips(self.path, fields, common)?))
            }
            Entry::Map(fields) => {
                let common = common.within(fields)?;
                let mut parts = Vec::new();
                let mut passed_over = None;
                for (key, inner) in fields {
                    if let Some(preferred) = preferred_to(key, fields) {
                        passed_over = Some((key, preferred));
                        continue;
                    }
                    let found = self.search(key, inner, &common)?;
                    if !found.is_empty() {
                        parts.push((key.clone(), Self::identified(found, inner)?));
                    }
                }
                let mut found = Self::joined(parts);
                if let Some((camera, world)) = passed_over {
                    for (_, clip) in &mut found {
                        clip.notes.push(format!(
                            "`{world}` is read, `{camera}`, in coordinates of the camera, is not"
                        ));
                    }
                }
                Ok(found)
            }
            Entry::List(entries) => {
                let mut found = Vec::new();
                for (index, inner) in entries.iter().enumerate() {
                    let own = match inner {
                        Entry::Numbers(numbers) if POSES.contains(&name) => {
                            numbered("", unnamed_clips(self.path, numbers)?.unwrap_or_default())
                        }
                        inner => self.search("", inner, common)?,
                    };
                    let id = id_of(inner)?.unwrap_or_else(|| index.to_string());
                    found.extend(own.into_iter().map(|(inner, clip)| (path_of(&id, &inner), clip)));
                }
                Ok(found)
            }
            _ => Ok(Vec::new()),
        }
    }

    /// Names people of a frame by the frame's list of their numbers, if it has one.
    fn identified(mut people: Vec<(String, Clip)>, entry: &Entry) -> Result<Vec<(String, Clip)>> {
        let Entry::Map(fields) = entry else { return Ok(people) };
        if people.len() > 1 || people.iter().all(|(_, clip)| clip.frames() == 1) {
            for name in IDS {
                let ids = fields.iter().find(|(found, _)| found == name);
                let Some((_, Entry::Numbers(ids))) = ids else { continue };
                // Longer lists name people who are not seen in this frame.
                if ids.shape.iter().product::<usize>() >= people.len() {
                    for (person, id) in people.iter_mut().zip(&ids.read()?) {
                        person.0 = id.to_string();
                    }
                    break;
                }
            }
        }
        Ok(people)
    }

    /// People of the parts of a dictionary. Parts named like images are frames, which are put
    /// together; others are people.
    fn joined(mut parts: Vec<(String, Vec<(String, Clip)>)>) -> Vec<(String, Clip)> {
        let frames = parts.len() > 1 && parts.iter().all(|(key, _)| is_image(key));
        let single =
            parts.iter().flat_map(|(_, people)| people).all(|(_, clip)| clip.frames() == 1);
        let by_number =
            parts.len() > 2 && single && parts.iter().all(|(key, _)| key.parse::<u64>().is_ok());
        if !(frames || by_number) {
            let alone = parts.len() == 1;
            return parts
                .into_iter()
                .flat_map(|(key, people)| {
                    let several = people.len() > 1;
                    people.into_iter().map(move |(name, clip)| {
                        let name = match (alone, several) {
                            (true, _) => name,
                            (false, false) => key.clone(),
                            (false, true) => path_of(&key, &name),
                        };
                        (name, clip)
                    })
                })
                .collect();
        }
        parts.sort_by(|(a, _), (b, _)| natural_order(a, b));
        joined_frames(parts.into_iter().map(|(_, people)| people).collect())
    }
}

/// People of consecutive frames, each with its people by name.
pub(super) fn joined_frames(frames: Vec<Vec<(String, Clip)>>) -> Vec<(String, Clip)> {
    let total = frames.len();
    let mut joined: Vec<(String, Vec<Clip>)> = Vec::new();
    for people in frames {
        let rows = people.into_iter().flat_map(|(name, clip)| {
            // Rows of one frame are people.
            let several = clip.frames() > 1;
            let split = (0..clip.frames()).map(|row| row_of(&clip, row)).collect::<Vec<_>>();
            split.into_iter().enumerate().map(move |(row, clip)| {
                let name = if several { path_of(&name, &row.to_string()) } else { name.clone() };
                (name, clip)
            })
        });
        for (name, clip) in rows {
            // A person alone in a frame is named by the frame.
            let name = if is_image(&name) { String::new() } else { name };
            match joined.iter_mut().find(|(known, _)| *known == name) {
                Some((_, clips)) => clips.push(clip),
                None => joined.push((name, vec![clip])),
            }
        }
    }
    joined.into_iter().map(|(name, clips)| (name, together(clips, total))).collect()
}

/// Clips of the same person in single frames as one clip.
fn together(clips: Vec<Clip>, total: usize) -> Clip {
    let mut clip = clips[0].clone();
    let count = clips.len();
    let stack =
        |views: &[ndarray::ArrayView2<f64>]| concatenate(Axis(0), views).unwrap_or_default();
    clip.poses = stack(&clips.iter().map(|clip| clip.poses.view()).collect::<Vec<_>>());
    let moves: Option<Vec<_>> =
        clips.iter().map(|clip| clip.translations.as_ref().map(|t| t.view())).collect();
    clip.translations = moves.map(|views| stack(&views));
    let length = clips.iter().map(|clip| clip.betas.len()).min().unwrap_or(0);
    clip.betas = (0..length)
        .map(|k| clips.iter().map(|clip| clip.betas[k]).sum::<f64>() / count as f64)
        .collect();
    clip.shapes = count;
    if count < total {
        clip.notes.push(format!("in {count} of {total} frames, which follow each other"));
    }
    clip
}

fn row_of(clip: &Clip, row: usize) -> Clip {
    let cut = |table: &ndarray::Array2<f64>| table.slice(ndarray::s![row..=row, ..]).to_owned();
    Clip {
        poses: cut(&clip.poses),
        translations: clip.translations.as_ref().map(cut),
        ..clip.clone()
    }
}

fn numbered(name: &str, clips: Vec<Clip>) -> Vec<(String, Clip)> {
    let several = clips.len() > 1;
    let named = |(index, clip): (usize, Clip)| {
        if several { (path_of(name, &index.to_string()), clip) } else { (name.to_owned(), clip) }
    };
    clips.into_iter().enumerate().map(named).collect()
}

/// Entry of the same in coordinates of the world, beside one in those of the camera.
fn preferred_to<'a>(key: &str, fields: &'a Fields) -> Option<&'a str> {
    let camera = key.strip_suffix("incam").or_else(|| key.strip_suffix("cam"))?;
    let beside = |(name, _): &&(String, Entry)| {
        ["global", "world"].into_iter().any(|end| name.strip_suffix(end) == Some(camera))
    };
    fields.iter().find(beside).map(|(name, _)| name.as_str())
}

fn path_of(outer: &str, inner: &str) -> String {
    match (outer, inner) {
        ("", name) | (name, "") => name.to_owned(),
        (outer, inner) => format!("{outer}.{inner}"),
    }
}

fn id_of(entry: &Entry) -> Result<Option<String>> {
    let Entry::Map(fields) = entry else { return Ok(None) };
    for name in IDS {
        let found: Option<&(String, Entry)> = fields.iter().find(|(found, _)| found == name);
        match found {
            Some((_, Entry::Numbers(numbers))) if numbers.shape.iter().all(|&n| n == 1) => {
                return Ok(numbers.read()?.iter().next().map(ToString::to_string));
            }
            Some((_, Entry::Text(text))) => return Ok(Some(text.clone())),
            _ => {}
        }
    }
    Ok(None)
}

fn is_image(key: &str) -> bool {
    let extension = Path::new(key).extension().and_then(|extension| extension.to_str());
    extension.is_some_and(|extension| {
        ["jpg", "jpeg", "png", "bmp", "webp"].contains(&extension.to_ascii_lowercase().as_str())
    })
}

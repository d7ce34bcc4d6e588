//! Keypoint files of detectors.

use std::path::Path;

use cape_core::npy::Npz;
use ndarray::Axis;
use serde_json::Value;

use super::{Detector, Keypoint, Keypoints};
use crate::{Error, Result};

/// Keypoints of all people in an image.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_synth::synthetic_body;
/// use cape_fit::{PinholeCamera, read_keypoints};
///
/// // Keypoints in an archive, read back.
/// let (_, keypoints) = seen(&synthetic_body(), &PinholeCamera::new(512, 512, None)?)?;
/// let directory = tempfile::tempdir()?;
/// let archive = directory.path().join("keypoints.npz");
/// let points = keypoints.points();
/// let rows = ndarray::Array2::from_shape_fn((points.len(), 3), |(point, column)| {
///     [points[point].x, points[point].y, points[point].confidence][column]
/// });
/// let mut file = cape_core::npy::NpzWriter::create(&archive)?;
/// file.add("keypoints", &rows)?;
/// file.finish()?;
/// let people = read_keypoints(&archive)?;
/// assert_eq!(people.len(), 1);
/// assert_eq!(people.choose(None)?, keypoints);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct People {
    people: Vec<Keypoints>,
}

impl People {
    /// Number of people.
    pub fn len(&self) -> usize {
        self.people.len()
    }

    /// True if there is no person.
    pub fn is_empty(&self) -> bool {
        self.people.is_empty()
    }

    /// Keypoints of all people in the order of the file.
    pub fn all(&self) -> &[Keypoints] {
        &self.people
    }

    /// Keypoints of the person with the index `person`; without an index, of the only person.
    ///
    /// # Errors
    /// If there is no such person, or there are several and `person` is `None`.
    pub fn choose(self, person: Option<usize>) -> Result<Keypoints> {
        let count = self.people.len();
        let refuse = |message: String| Err(Error::Observation(message));
        match (person, count) {
            (_, 0) => refuse("the file contains no person".into()),
            (None, 2..) => refuse(format!(
                "the file contains {count} people: choose one by its index, 0 to {}",
                count - 1
            )),
            (person, _) => {
                let person = person.unwrap_or(0);
                match self.people.into_iter().nth(person) {
                    Some(keypoints) => Ok(keypoints),
                    None => {
                        refuse(format!("person {person}: expected an index of 0 to {}", count - 1))
                    }
                }
            }
        }
    }
}

/// Reads keypoints: JSON of OpenPose (`people` with `pose_keypoints_2d`, BODY_25 or COCO-18), JSON
/// of COCO (a list of results with `keypoints`, or an object with `annotations`), or an `.npz`
/// archive with `keypoints` `[points, 3]` or `[people, points, 3]`, each x, y (pixels) and
/// confidence.
///
/// Results and annotations must be of one image. Visibility flags of 1 and 2 are confidence 1.
///
/// # Errors
/// If the file has none of these formats; the error has the entry.
pub fn read_keypoints(path: impl AsRef<Path>) -> Result<People> {
    let path = path.as_ref();
    let extension = path.extension().unwrap_or_default();
    if extension.eq_ignore_ascii_case("npz") {
        from_archive(path)
    } else if extension.eq_ignore_ascii_case("json") {
        let text = std::fs::read(path).map_err(|source| Error::io(path, source))?;
        let json = serde_json::from_slice(&text)
            .map_err(|error| Error::format(path, format!("not JSON: {error}")))?;
        from_json(path, &json)
    } else {
        Err(Error::format(path, "unsupported file type: expected .json or .npz"))
    }
}

fn from_archive(path: &Path) -> Result<People> {
    let mut file = Npz::open(path)?;
    let array = file.f64("keypoints")?;
    let array = if array.ndim() == 2 { array.insert_axis(Axis(0)) } else { array };
    file.expect_shape("keypoints", array.shape(), &[None, None, Some(3)])?;
    let people = array.outer_iter().map(|person| {
        let numbers: Vec<f64> = person.iter().copied().collect();
        keypoints(path, "keypoints", &numbers)
    });
    Ok(People { people: people.collect::<Result<_>>()? })
}

fn from_json(path: &Path, json: &Value) -> Result<People> {
    if let Some(people) = json.get("people") {
        let people = list(path, "people", people)?.iter().enumerate().map(|(at, person)| {
            let field = format!("people[{at}].pose_keypoints_2d");
            keypoints(path, &field, &numbers(path, &field, person.get("pose_keypoints_2d"))?)
        });
        return Ok(People { people: people.collect::<Result<_>>()? });
    }
    let (name, entries) = match json.get("annotations") {
        Some(annotations) => ("annotations", annotations),
        None => ("results", json),
    };
    let Some(entries) = entries.as_array() else {
        return Err(Error::format(
            path,
            "expected OpenPose's `people`, or COCO's list of results or `annotations`",
        ));
    };
    one_image(path, name, entries)?;
    let people = entries.iter().enumerate().map(|(at, entry)| {
        let field = format!("{name}[{at}].keypoints");
        keypoints(path, &field, &numbers(path, &field, entry.get("keypoints"))?)
    });
    Ok(People { people: people.collect::<Result<_>>()? })
}

fn one_image(path: &Path, name: &str, entries: &[Value]) -> Result<()> {
    let images = || entries.iter().map(|entry| entry.get("image_id"));
    match images().position(|image| image != images().next().flatten()) {
        None => Ok(()),
        Some(at) => Err(Error::field(
            path,
            format!("{name}[{at}].image_id"),
            "differs from that of the first entry: expected the people of one image",
        )),
    }
}

fn list<'a>(path: &Path, field: &str, value: &'a Value) -> Result<&'a Vec<Value>> {
    value.as_array().ok_or_else(|| Error::field(path, field, "expected a list"))
}

fn numbers(path: &Path, field: &str, value: Option<&Value>) -> Result<Vec<f64>> {
    let value = value.ok_or_else(|| Error::field(path, field, "missing"))?;
    let number = |value: &Value| {
        value.as_f64().ok_or_else(|| Error::field(path, field, "expected a list of numbers"))
    };
    list(path, field, value)?.iter().map(number).collect()
}

/// Keypoints from x, y and confidence of each point.
fn keypoints(path: &Path, field: &str, numbers: &[f64]) -> Result<Keypoints> {
    let (points, rest) = numbers.as_chunks::<3>();
    let Some(detector) = Detector::from_point_count(points.len()).filter(|_| rest.is_empty())
    else {
        let layouts: Vec<String> =
            Detector::ALL.iter().map(|d| format!("{} ({d})", 3 * d.points())).collect();
        return Err(Error::field(
            path,
            field,
            format!("{} numbers, expected {}", numbers.len(), layouts.join(" or ")),
        ));
    };
    let point = |&[x, y, confidence]: &[f64; 3]| Keypoint { x, y, confidence };
    Keypoints::new(detector, points.iter().map(point).collect())
        .map_err(|error| Error::field(path, field, error.to_string()))
}

#[cfg(test)]
mod tests {
    use cape_core::npy::NpzWriter;
    use ndarray::Array3;

    use super::*;

    fn read(name: &str, text: &str) -> Result<People> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join(name);
        std::fs::write(&path, text).unwrap();
        read_keypoints(&path)
    }

    fn row(points: usize, confidence: f64) -> String {
        let numbers: Vec<String> =
            (0..points).map(|i| format!("{}.5,{},{confidence}", i, 2 * i)).collect();
        numbers.join(",")
    }

    #[test]
    fn openpose_and_coco_files_are_told_apart() {
        for (points, detector) in [(25, Detector::Body25), (18, Detector::Coco18)] {
            let person = format!("{{\"pose_keypoints_2d\": [{}]}}", row(points, 0.7));
            let people =
                read("a.json", &format!("{{\"version\": 1.3, \"people\": [{person}]}}")).unwrap();
            let keypoints = people.choose(None).unwrap();
            assert_eq!(keypoints.detector(), detector);
            assert_eq!(keypoints.points()[3], Keypoint { x: 3.5, y: 6.0, confidence: 0.7 });
        }
        let entry =
            |image: usize| format!("{{\"image_id\": {image}, \"keypoints\": [{}]}}", row(17, 2.0));
        for text in [
            format!("[{}, {}]", entry(1), entry(1)),
            format!("{{\"annotations\": [{}, {}]}}", entry(1), entry(1)),
        ] {
            let people = read("a.json", &text).unwrap();
            assert_eq!(people.len(), 2);
            assert!(people.clone().choose(None).unwrap_err().to_string().contains("2 people"));
            assert!(people.clone().choose(Some(2)).unwrap_err().to_string().contains("person 2"));
            let person = people.choose(Some(1)).unwrap();
            assert_eq!(person.detector(), Detector::Coco17);
            assert_eq!(person.points()[16].confidence, 1.0);
        }
        let several = read("a.json", &format!("[{}, {}]", entry(1), entry(2))).unwrap_err();
        assert!(several.to_string().contains("results[1].image_id"), "{several}");
    }

    #[test]
    fn archives_hold_one_person_or_several() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.npz");
        let save = |array: Array3<f64>, one: bool| {
            let mut file = NpzWriter::create(&path).unwrap();
            if one {
                file.add("keypoints", &array.index_axis_move(Axis(0), 0)).unwrap();
            } else {
                file.add("keypoints", &array).unwrap();
            }
            file.finish().unwrap();
        };
        let points = Array3::from_shape_fn((2, 24, 3), |(p, i, k)| ((p + i + k) % 2) as f64);
        save(points.clone(), true);
        let person = read_keypoints(&path).unwrap().choose(None).unwrap();
        assert_eq!(person.detector(), Detector::Smpl24);
        assert_eq!(person.points()[1], Keypoint { x: 1.0, y: 0.0, confidence: 1.0 });
        save(points, false);
        assert_eq!(read_keypoints(&path).unwrap().len(), 2);
        save(Array3::from_elem((1, 24, 3), f64::INFINITY), false);
        assert!(read_keypoints(&path).unwrap_err().to_string().contains("keypoints"));
    }

    #[test]
    fn malformed_files_name_the_entry() {
        let cases = [
            ("{\"people\": []}", "no person"),
            ("{\"people\": [{}]}", "people[0].pose_keypoints_2d"),
            ("{\"people\": [{\"pose_keypoints_2d\": [1, 2, 3]}]}", "3 numbers, expected 75"),
            ("{\"people\": 3}", "expected a list"),
            ("{\"other\": 3}", "annotations"),
            ("[{\"keypoints\": [\"x\"]}]", "results[0].keypoints"),
            ("nonsense", "not JSON"),
        ];
        for (text, expected) in cases {
            let error = read("a.json", text).and_then(|people| people.choose(None)).unwrap_err();
            assert!(error.to_string().contains(expected), "{error}");
        }
        assert!(read("a.txt", "").is_err());
    }
}

//! Keypoint files of detectors.

use std::path::Path;

use cape_core::npy::Npz;
use ndarray::Axis;
use serde_json::Value;

use super::{
    Keypoint, KeypointLayout, Keypoints,
    dialect::{Entry, entries},
    plausibility::{LayoutChoice, choose_layout},
    read_json,
};
use crate::{Error, Mask, Result};

/// Largest coordinate of normalised keypoints.
const NORMALISED: f64 = 1.5;
/// Least coordinate of keypoints normalised to 0…1; smaller ones are normalised to −1…1.
const CENTRED: f64 = -0.25;

/// Options of reading keypoints.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct KeypointOptions {
    /// Layout; by default that of the number of points and, if several have it, of the most
    /// plausible person.
    pub layout: Option<KeypointLayout>,
    /// Identifier or file name of the image in a file of several images.
    pub image: Option<String>,
    /// File names of image and mask, by which an image of a file of several is found.
    pub beside: Vec<String>,
    /// Width and height of the image, pixels, by which normalised coordinates are scaled.
    pub size: Option<[u32; 2]>,
}

/// Person of a keypoint file.
#[derive(Debug, Clone, PartialEq)]
pub struct Person {
    /// Keypoints; the error says why there are none.
    pub keypoints: Result<Keypoints, String>,
    /// COCO's outline of the person, polygons or run lengths.
    pub segmentation: Option<Value>,
}

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
    all: Vec<Person>,
    notes: Vec<String>,
    size: Option<[u32; 2]>,
}

impl People {
    /// Number of people, including those without usable keypoints.
    pub fn len(&self) -> usize {
        self.all.len()
    }

    /// True if there is no person.
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// All people in the order of the file.
    pub fn all(&self) -> &[Person] {
        &self.all
    }

    /// Remarks on the choices that the file leaves open, for the user.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Width and height of the image by the file, pixels.
    pub fn size(&self) -> Option<[u32; 2]> {
        self.size
    }

    /// Keypoints of the person with the index `person`; without an index, of the only person.
    ///
    /// # Errors
    /// If there is no such person, or there are several and `person` is `None`.
    pub fn choose(self, person: Option<usize>) -> Result<Keypoints> {
        let index = self.index(person, None)?;
        self.person(index)
    }

    /// Index of the person `person`; without it, of the person on `mask`; without both, of the only
    /// person.
    ///
    /// # Errors
    /// If there is no such person, or the choice is open.
    pub fn index(&self, person: Option<usize>, mask: Option<&Mask>) -> Result<usize> {
        let count = self.all.len();
        if count == 0 {
            return refuse("the keypoints are of nobody: the file contains no person".into());
        }
        if let Some(person) = person {
            if person < count {
                return Ok(person);
            }
            return refuse(format!("person {person}: expected an index of 0 to {}", count - 1));
        }
        let seen: Vec<(usize, &Keypoints)> =
            (0..count).filter_map(|at| Some((at, self.all[at].keypoints.as_ref().ok()?))).collect();
        match (seen.as_slice(), mask) {
            // The error of the first person says why nobody is usable.
            ([], _) => Ok(0),
            (&[(only, _)], _) => Ok(only),
            (several, Some(mask)) => {
                let mut on: Vec<(f64, usize)> = several
                    .iter()
                    .map(|&(at, k)| (mask.share_of(&k.detections(0.0)), at))
                    .collect();
                on.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
                if on[0].0 >= 0.5 && on[0].0 > on[1].0 {
                    return Ok(on[0].1);
                }
                refuse(format!("{}: choose one by its index\n{}", open(&on), places(several)))
            }
            (several, None) => refuse(format!(
                "the file contains {} people: choose one by its index, 0 to {}\n{}",
                several.len(),
                count - 1,
                places(several)
            )),
        }
    }

    /// Keypoints of a person by index.
    ///
    /// # Errors
    /// If there is no such person, or the person has no usable keypoints.
    pub fn person(&self, index: usize) -> Result<Keypoints> {
        match self.all.get(index).map(|person| &person.keypoints) {
            Some(Ok(keypoints)) => Ok(keypoints.clone()),
            Some(Err(reason)) => refuse(reason.clone()),
            None => refuse(format!("person {index}: the file has {}", self.all.len())),
        }
    }
}

fn refuse<T>(message: String) -> Result<T> {
    Err(Error::Observation(message))
}

fn open(on: &[(f64, usize)]) -> String {
    if on[0].0 < 0.5 {
        format!("none of {} people is on the mask", on.len())
    } else {
        format!("people {} and {} are on the mask alike", on[0].1, on[1].1)
    }
}

/// Middle of each person in the image.
fn places(people: &[(usize, &Keypoints)]) -> String {
    let line = |&(at, keypoints): &(usize, &Keypoints)| {
        let seen = keypoints.detections(0.0);
        let count = seen.len().max(1) as f64;
        let [x, y] = [|k: &Keypoint| k.x, |k: &Keypoint| k.y]
            .map(|of| seen.iter().map(|s| of(&s.at)).sum::<f64>() / count);
        format!("person {at}: {} joints around ({x:.0}, {y:.0})", seen.len())
    };
    people.iter().take(20).map(line).collect::<Vec<_>>().join("\n")
}

/// [`read_keypoints_with`] without options.
///
/// # Errors
/// As of [`read_keypoints_with`].
pub fn read_keypoints(path: impl AsRef<Path>) -> Result<People> {
    read_keypoints_with(path, &KeypointOptions::default())
}

/// Reads keypoints of the people in one image: JSON of OpenPose, COCO (results and annotations),
/// AlphaPose, MMPose, MediaPipe and others that write points as lists of numbers, lists or objects;
/// or an `.npz` archive with `keypoints` `[points, 3]` or `[people, points, 3]`, each x, y (pixels)
/// and confidence.
///
/// Points are unseen that are NaN, `null`, at (0, 0) or (−1, −1), or of a confidence of 0 or less.
/// Visibility flags of 1 and 2 are confidence 1. Coordinates between 0 and 1 are scaled to the
/// image. A person who cannot be read does not refuse the others.
///
/// # Errors
/// If the file has none of these formats, or has several images and the options do not tell which.
pub fn read_keypoints_with(path: impl AsRef<Path>, options: &KeypointOptions) -> Result<People> {
    let path = path.as_ref();
    let extension = path.extension().unwrap_or_default();
    if extension.eq_ignore_ascii_case("npz") {
        return Ok(people(&from_archive(path)?, options));
    }
    if !extension.eq_ignore_ascii_case("json") {
        return Err(Error::format(path, "unsupported file type: expected .json or .npz"));
    }
    let all = entries(&read_json(path)?).map_err(|reason| Error::format(path, reason))?;
    let found = one_image(all, options).map_err(|reason| Error::format(path, reason))?;
    Ok(people(&found, options))
}

fn from_archive(path: &Path) -> Result<Vec<Entry>> {
    let mut file = Npz::open(path)?;
    let array = file.f64("keypoints")?;
    let array = if array.ndim() == 2 { array.insert_axis(Axis(0)) } else { array };
    file.expect_shape("keypoints", array.shape(), &[None, None, Some(3)])?;
    let person = |(at, person): (usize, ndarray::ArrayViewD<'_, f64>)| Entry {
        field: format!("keypoints[{at}]"),
        images: Vec::new(),
        size: None,
        points: Ok(person.outer_iter().map(|p| [p[0], p[1], p[2]]).collect()),
        segmentation: None,
    };
    Ok(array.outer_iter().enumerate().map(person).collect())
}

/// Entries of the image that the options tell.
fn one_image(all: Vec<Entry>, options: &KeypointOptions) -> Result<Vec<Entry>, String> {
    let mut images: Vec<&Vec<String>> = all.iter().map(|entry| &entry.images).collect();
    images.sort();
    images.dedup();
    // A file that does not name its image is of the one that is asked for.
    let unnamed = images.iter().all(|names| names.is_empty());
    if images.len() < 2 && (options.image.is_none() || unnamed) {
        return Ok(all);
    }
    let is = |name: &str| {
        let found = |entry: &&Entry| entry.images.iter().any(|image| same_image(image, name));
        all.iter().filter(found).cloned().collect::<Vec<_>>()
    };
    let names: Vec<String> =
        images.iter().take(6).map(|names| names.join(" ")).filter(|n| !n.is_empty()).collect();
    let names = names.join(", ");
    if let Some(image) = &options.image {
        let found = is(image);
        if found.is_empty() {
            return Err(format!("no person of image `{image}`: the file has {names}…"));
        }
        return Ok(found);
    }
    let found = options.beside.iter().map(|name| is(name)).find(|found| !found.is_empty());
    found.ok_or_else(|| {
        format!("people of {} images ({names}…): choose one with --image-id", images.len())
    })
}

/// True if two names or numbers are of one image: equal, of the same file name, or a number written
/// with zeros before it.
fn same_image(a: &str, b: &str) -> bool {
    let stem = |name: &str| {
        let name = name.rsplit(['/', '\\']).next().unwrap_or(name);
        let known = ["jpg", "jpeg", "png", "webp", "json", "bmp", "npz"];
        match name.rsplit_once('.') {
            Some((stem, end)) if known.contains(&end.to_lowercase().as_str()) => stem.to_owned(),
            _ => name.to_owned(),
        }
    };
    let (a, b) = (stem(a), stem(b));
    let number = |text: &str| text.parse::<u64>().ok();
    a == b || (number(&a).is_some() && number(&a) == number(&b))
}

/// People of one image.
fn people(entries: &[Entry], options: &KeypointOptions) -> People {
    let size = options.size.or_else(|| entries.iter().find_map(|entry| entry.size));
    let mut notes = Vec::new();
    let cleaned: Vec<Result<Vec<Keypoint>, String>> = entries
        .iter()
        .map(|entry| {
            let points = entry.points.as_ref().map_err(|e| format!("{}: {e}", entry.field))?;
            if points.is_empty() {
                return Err(format!("{}: nobody, it has no points", entry.field));
            }
            let points = points.iter().map(seen).collect();
            in_pixels(points, size, &mut notes).map_err(|e| format!("{}: {e}", entry.field))
        })
        .collect();
    notes.dedup();
    let layout = |count: usize| -> Result<LayoutChoice, String> {
        if let Some(layout) = options.layout {
            return Ok(LayoutChoice { layout, note: None });
        }
        let alike: Vec<&[Keypoint]> = cleaned
            .iter()
            .filter_map(|p| p.as_deref().ok())
            .filter(|points| points.len() == count)
            .collect();
        choose_layout(&alike, count).ok_or_else(|| {
            let known: Vec<String> =
                KeypointLayout::ALL.iter().map(|l| format!("{} ({l})", l.points())).collect();
            format!("{count} points, expected {}", known.join(", "))
        })
    };
    let mut all = Vec::with_capacity(entries.len());
    for (entry, points) in entries.iter().zip(&cleaned) {
        let keypoints = points.clone().and_then(|points| {
            let choice = layout(points.len()).map_err(|e| format!("{}: {e}", entry.field))?;
            notes.extend(choice.note);
            let keypoints = Keypoints::new(choice.layout, points)
                .map_err(|error| format!("{}: {error}", entry.field))?;
            if keypoints.detections(0.0).is_empty() {
                return Err(format!("{}: nobody, none of the joints is seen", entry.field));
            }
            Ok(keypoints)
        });
        all.push(Person { keypoints, segmentation: entry.segmentation.clone() });
    }
    notes.sort();
    notes.dedup();
    People { all, notes, size }
}

/// The point; unseen at the places that detectors write for it.
fn seen(&[x, y, confidence]: &[f64; 3]) -> Keypoint {
    let nowhere = (x == 0.0 && y == 0.0) || (x == -1.0 && y == -1.0);
    let usable = x.is_finite() && y.is_finite() && confidence > 0.0 && !nowhere;
    if usable { Keypoint { x, y, confidence } } else { Keypoint::UNSEEN }
}

/// The points in pixels, if they are normalised to 0…1 or −1…1.
fn in_pixels(
    mut points: Vec<Keypoint>,
    size: Option<[u32; 2]>,
    notes: &mut Vec<String>,
) -> Result<Vec<Keypoint>, String> {
    let seen = || points.iter().filter(|point| point.confidence > 0.0);
    let numbers = || seen().flat_map(|point| [point.x, point.y]);
    let largest = numbers().fold(0.0, |most: f64, x| most.max(x.abs()));
    if seen().count() < 2 || largest > NORMALISED {
        return Ok(points);
    }
    let Some([width, height]) = size else {
        return Err(
            "all coordinates are at most 1, expected pixels: give the image or its mask, by \
                    whose size they are scaled"
                .into(),
        );
    };
    let centred = numbers().any(|x| x < CENTRED);
    for point in points.iter_mut().filter(|point| point.confidence > 0.0) {
        let scale = |x: f64, side: u32| f64::from(side) * if centred { 0.5 * (x + 1.0) } else { x };
        (point.x, point.y) = (scale(point.x, width), scale(point.y, height));
    }
    let range = if centred { "−1 to 1" } else { "0 to 1" };
    notes.push(format!("coordinates from {range} are scaled to {width}×{height} pixels"));
    Ok(points)
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
        for points in [25, 18] {
            let person = format!("{{\"pose_keypoints_2d\": [{}]}}", row(points, 0.7));
            let people =
                read("a.json", &format!("{{\"version\": 1.3, \"people\": [{person}]}}")).unwrap();
            let keypoints = people.choose(None).unwrap();
            assert_eq!(keypoints.layout().points(), points);
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
            assert_eq!(person.layout().points(), 17);
            assert_eq!(person.points()[16].confidence, 1.0);
        }
        let several = read("a.json", &format!("[{}, {}]", entry(1), entry(2))).unwrap_err();
        assert!(several.to_string().contains("2 images (1, 2…)"), "{several}");
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
        let points =
            Array3::from_shape_fn(
                (2, 24, 3),
                |(p, i, k)| if k == 2 { 1.0 } else { (10 * (p + i) + 1) as f64 },
            );
        save(points.clone(), true);
        let person = read_keypoints(&path).unwrap().choose(None).unwrap();
        assert_eq!(person.layout(), KeypointLayout::Smpl24);
        assert_eq!(person.points()[1], Keypoint { x: 11.0, y: 11.0, confidence: 1.0 });
        save(points, false);
        assert_eq!(read_keypoints(&path).unwrap().len(), 2);
        save(Array3::from_elem((1, 24, 3), f64::INFINITY), false);
        let nobody = read_keypoints(&path).unwrap().choose(None).unwrap_err().to_string();
        assert!(nobody.contains("keypoints[0]: nobody"), "{nobody}");
    }

    #[test]
    fn malformed_files_name_the_entry() {
        let cases = [
            ("{\"people\": []}", "no person"),
            ("{\"people\": [{}]}", "people[0].pose_keypoints_2d"),
            (
                "{\"people\": [{\"pose_keypoints_2d\": [1, 2, 3]}]}",
                "1 points, expected 25 (BODY_25)",
            ),
            ("{\"people\": 3}", "expected a list"),
            ("{\"other\": 3}", "annotations"),
            ("[{\"keypoints\": [\"x\"]}]", "results[0].keypoints"),
            ("[{\"keypoints\": [1, 2, 3, 4, 5]}]", "5 numbers"),
            ("nonsense", "not JSON"),
        ];
        for (text, expected) in cases {
            let error = read("a.json", text).and_then(|people| people.choose(None)).unwrap_err();
            assert!(error.to_string().contains(expected), "{error}");
        }
        assert!(read("a.txt", "").is_err());
    }
}

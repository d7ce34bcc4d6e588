//! Scans from files, and checks of their size and unit.

use std::path::Path;

use cape_core::{obj, ply};
use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::sample::spread;
use crate::{Error, Result};

/// Fewest points of a scan.
const FEWEST: usize = 200;
/// Range of the largest extent of a person in any pose, metres.
const PERSON: [f64; 2] = [0.5, 3.0];

/// Unit of length of a scan.
///
/// ```
/// use cape_fit::scan::Unit;
///
/// assert_eq!("cm".parse::<Unit>()?.metres(), 0.01);
/// assert!("ft".parse::<Unit>().is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Unit {
    /// Metres.
    M,
    /// Centimetres.
    Cm,
    /// Millimetres.
    Mm,
}

impl Unit {
    /// All units.
    pub const ALL: [Self; 3] = [Self::M, Self::Cm, Self::Mm];

    /// Symbol.
    pub const fn name(self) -> &'static str {
        match self {
            Self::M => "m",
            Self::Cm => "cm",
            Self::Mm => "mm",
        }
    }

    /// Length of the unit, metres.
    pub const fn metres(self) -> f64 {
        match self {
            Self::M => 1.0,
            Self::Cm => 0.01,
            Self::Mm => 0.001,
        }
    }
}

impl std::str::FromStr for Unit {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let known = Self::ALL.into_iter().find(|unit| unit.name() == text);
        known.ok_or_else(|| Error::argument(format!("unit `{text}`, expected m, cm or mm")))
    }
}

/// A scan of a person: a point cloud or a triangle mesh, metres.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_fit::scan::{Scan, Unit, distances_to};
///
/// // The vertices of a body in metres.
/// let (points, _) = person();
/// let scan = Scan::new(points.clone(), None, Vec::new(), Unit::M)?;
/// assert_eq!((scan.points().len(), scan.faces().len()), (points.len(), 0));
/// assert!(distances_to(&scan, &points[..10]).iter().all(|&far| far < 1e-9));
/// // Below the size of a person.
/// assert!(Scan::new(points, None, Vec::new(), Unit::Mm).is_err());
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    points: Vec<DVec3>,
    normals: Option<Vec<DVec3>>,
    faces: Vec<[u32; 3]>,
}

impl Scan {
    /// A scan of points in `unit`, `[n]`, with optional normals `[n]`, and triangles, empty for a
    /// point cloud.
    ///
    /// # Errors
    /// If there are too few points, numbers are not finite, the number of normals differs, a face
    /// index is out of range, or the extent is not that of a person.
    pub fn new(
        points: Vec<DVec3>,
        normals: Option<Vec<DVec3>>,
        faces: Vec<[u32; 3]>,
        unit: Unit,
    ) -> Result<Self> {
        let refuse = |message: String| Err(Error::Observation(message));
        if points.len() < FEWEST {
            return refuse(format!("scan: {} points, expected at least {FEWEST}", points.len()));
        }
        if let Some(index) = points.iter().position(|point| !point.is_finite()) {
            return refuse(format!("scan: point {index} is not finite: {}", points[index]));
        }
        if let Some(normals) = &normals
            && normals.len() != points.len()
        {
            return refuse(format!(
                "scan: {} normals for {} points, expected one for each point",
                normals.len(),
                points.len()
            ));
        }
        let outside = |face: &&[u32; 3]| face.iter().any(|&at| at as usize >= points.len());
        if let Some(face) = faces.iter().find(outside) {
            return refuse(format!("scan: face {face:?}, expected indices below {}", points.len()));
        }
        let points: Vec<DVec3> = points.into_iter().map(|point| point * unit.metres()).collect();
        check_size(&points, unit)?;
        let normals = normals
            .map(|all| all.into_iter().map(DVec3::normalize_or_zero).collect::<Vec<_>>())
            .filter(|all| all.iter().any(|normal| *normal != DVec3::ZERO));
        Ok(Self { points, normals, faces })
    }

    /// Reads a `.ply` or `.obj` file.
    ///
    /// # Errors
    /// If the file cannot be read, or as of [`new`](Self::new).
    pub fn load(path: impl AsRef<Path>, unit: Unit) -> Result<Self> {
        let path = path.as_ref();
        let is = |name| path.extension().is_some_and(|found| found.eq_ignore_ascii_case(name));
        let (mesh, normals) = match (is("ply"), is("obj")) {
            (true, _) => ply::read_with_normals(path)?,
            (_, true) => (obj::read(path)?.mesh, None),
            _ => return Err(Error::format(path, "unsupported file type: expected .ply or .obj")),
        };
        let vectors = |rows: Vec<[f32; 3]>| -> Vec<DVec3> {
            rows.into_iter().map(|row| DVec3::from_array(row.map(f64::from))).collect()
        };
        Self::new(vectors(mesh.vertices), normals.map(vectors), mesh.faces, unit).map_err(|error| {
            match error {
                Error::Observation(message) => Error::format(path, message),
                other => other,
            }
        })
    }

    /// Points, metres, `[n]`.
    pub fn points(&self) -> &[DVec3] {
        &self.points
    }

    /// Unit normals, `[n]`; `None` if unknown.
    pub fn normals(&self) -> Option<&[DVec3]> {
        self.normals.as_deref()
    }

    /// Triangles, `[faces]`; empty for a point cloud.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }
}

/// An error unless the extent is that of a person, with a better unit if there is one.
fn check_size(points: &[DVec3], unit: Unit) -> Result<()> {
    // Without 1 % outliers at each end.
    let extent = spread(points, 0.01).max_element();
    let [least, most] = PERSON;
    if (least..=most).contains(&extent) {
        return Ok(());
    }
    let units = extent / unit.metres();
    let fits = |other: &Unit| (least..=most).contains(&(units * other.metres()));
    let advice = match Unit::ALL.iter().find(|&other| *other != unit && fits(other)) {
        Some(other) => format!("use the unit {0} (--unit {0})", other.name()),
        None => "check that it contains one person".into(),
    };
    Err(Error::Observation(format!(
        "scan: extent {units:.4} {}, expected {least} to {most} m: {advice}",
        unit.name()
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(size: f64) -> Vec<DVec3> {
        let at =
            |i: i32| DVec3::new(f64::from(i % 7), f64::from(i) / 10.0, f64::from(i % 5)) * 0.03;
        (0..600).map(|i| at(i) * size).collect()
    }

    fn message(points: Vec<DVec3>, unit: Unit) -> String {
        Scan::new(points, None, Vec::new(), unit).unwrap_err().to_string()
    }

    #[test]
    fn other_units_are_named() {
        assert!(Scan::new(cloud(1.0), None, Vec::new(), Unit::M).is_ok());
        assert!(message(cloud(1000.0), Unit::M).contains("--unit mm"));
        assert!(message(cloud(100.0), Unit::M).contains("--unit cm"));
        assert!(message(cloud(1.0), Unit::Mm).contains("--unit m"));
        assert!(message(cloud(1e5), Unit::M).contains("one person"));
        let scan = Scan::new(cloud(1000.0), None, Vec::new(), Unit::Mm).unwrap();
        let metres = cloud(1.0);
        assert!(scan.points().iter().zip(&metres).all(|(a, b)| a.distance(*b) < 1e-9));
    }

    #[test]
    fn a_stray_point_does_not_change_the_unit() {
        let mut points = cloud(1.0);
        points.push(DVec3::splat(500.0));
        assert!(Scan::new(points, None, Vec::new(), Unit::M).is_ok());
    }

    #[test]
    fn invalid_scans_are_refused() {
        assert!(message(Vec::new(), Unit::M).contains("0 points"));
        assert!(message(cloud(1.0)[..50].to_vec(), Unit::M).contains("50 points"));
        let mut broken = cloud(1.0);
        broken[7].y = f64::NAN;
        assert!(message(broken, Unit::M).contains("point 7 is not finite"));
        let few = Scan::new(cloud(1.0), Some(vec![DVec3::X]), Vec::new(), Unit::M);
        assert!(few.unwrap_err().to_string().contains("1 normals"));
        let wrong = Scan::new(cloud(1.0), None, vec![[0, 1, 600]], Unit::M);
        assert!(wrong.unwrap_err().to_string().contains("[0, 1, 600]"));
        // Zero normals count as unknown.
        let zero = Scan::new(cloud(1.0), Some(vec![DVec3::ZERO; 600]), Vec::new(), Unit::M);
        assert_eq!(zero.unwrap().normals(), None);
    }

    #[test]
    fn units_are_known_by_their_signs() {
        assert!(Unit::ALL.iter().all(|unit| unit.name().parse::<Unit>().unwrap() == *unit));
        assert!("inch".parse::<Unit>().unwrap_err().to_string().contains("inch"));
    }
}

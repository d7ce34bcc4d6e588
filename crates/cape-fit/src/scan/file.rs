//! Scans from files, and checks of their size and unit.

use std::path::Path;

use cape_core::{MeshFile, npy::Npz};
use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::sample::spread;
use crate::{Error, Result};

/// Fewest points of a scan.
const FEWEST: usize = 200;
/// Range of the largest extent of a person in any pose, metres.
const PERSON: [f64; 2] = [0.5, 3.0];
/// The same of an adult who stands.
const ADULT: [f64; 2] = [1.2, 2.3];
/// Largest extent that a scan of unknown unit is scaled to, metres.
const USUAL: f64 = 1.7;
/// Sizes to which scans are scaled for neural networks: a cube of unit side, and from −1 to 1.
const NORMALISED: [f64; 2] = [1.0, 2.0];
/// Arrays of a point cloud in POP's packed data.
const POINTS: &str = "scan_pc";
const NORMALS: &str = "scan_n";
/// Largest share of points that are not finite.
const MOST_REMOVED: f64 = 0.05;

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

/// Unit of a scan, or the wish to find it out.
///
/// ```
/// use cape_fit::scan::{ScanUnit, Unit};
///
/// assert_eq!("mm".parse::<ScanUnit>()?, ScanUnit::from(Unit::Mm));
/// assert_eq!("auto".parse::<ScanUnit>()?, ScanUnit::Auto);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScanUnit {
    /// A known unit, in which the scan has the size of a person.
    Known(Unit),
    /// A known unit of a scan of any size, as of a garment.
    OfAnySize(Unit),
    /// The unit in which the scan is as large as a person; a scan of normalised size, or of a size
    /// that no unit explains, is scaled to 1.7 m.
    Auto,
}

impl From<Unit> for ScanUnit {
    fn from(unit: Unit) -> Self {
        Self::Known(unit)
    }
}

impl std::str::FromStr for ScanUnit {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        let unit: Result<Unit> = text.parse();
        unit.map(Self::Known)
            .map_err(|_| Error::argument(format!("unit `{text}`, expected auto, m, cm or mm")))
    }
}

/// Numbers of points and triangles of a scan that were left out.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct RemovedElements {
    /// Points that are not finite.
    pub points: usize,
    /// Triangles at them.
    pub faces: usize,
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
    scale: f64,
    removed: RemovedElements,
    remark: Option<String>,
}

impl Scan {
    /// A scan of points in `unit`, `[n]`, with optional normals `[n]`, and triangles, empty for a
    /// point cloud. Points that are not finite, and the triangles at them, are left out.
    ///
    /// # Errors
    /// If there are too few points, more than 5 % of them are not finite, the number of normals
    /// differs, a face index is out of range, or the extent is not that of a person.
    pub fn new(
        points: Vec<DVec3>,
        normals: Option<Vec<DVec3>>,
        faces: Vec<[u32; 3]>,
        unit: impl Into<ScanUnit>,
    ) -> Result<Self> {
        let refuse = |message: String| Err(Error::Observation(message));
        if points.len() < FEWEST {
            return refuse(format!("scan: {} points, expected at least {FEWEST}", points.len()));
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
        let mut scan = Self {
            points,
            normals,
            faces,
            scale: 1.0,
            removed: RemovedElements::default(),
            remark: None,
        };
        scan.remove_not_finite()?;
        scan.rescale(unit.into())?;
        scan.normals = scan
            .normals
            .map(|all| all.into_iter().map(DVec3::normalize_or_zero).collect::<Vec<_>>())
            .filter(|all| all.iter().any(|normal| *normal != DVec3::ZERO));
        Ok(scan)
    }

    /// Reads an OBJ, PLY, STL, OFF or `.glb` file, or the point cloud `scan_pc` `[n, 3]` with its normals
    /// `scan_n` of an `.npz` file as POP's packed data have it.
    ///
    /// # Errors
    /// If the file cannot be read, or as of [`new`](Self::new).
    pub fn load(path: impl AsRef<Path>, unit: impl Into<ScanUnit>) -> Result<Self> {
        let path = path.as_ref();
        if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("npz")) {
            return Self::load_points(path, unit.into());
        }
        let MeshFile { mesh, normals, .. } = MeshFile::read(path)?;
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

    fn load_points(path: &Path, unit: ScanUnit) -> Result<Self> {
        let mut archive = Npz::open(path)?;
        if !archive.contains(POINTS) {
            let message = format!(
                "no point cloud: expected `{POINTS}` [n, 3]; the archive has {}",
                archive.names().join(", ")
            );
            return Err(Error::format(path, message));
        }
        let mut read = |name: &str| -> Result<Vec<DVec3>> {
            let rows = archive.f64(name)?;
            archive.expect_shape(name, rows.shape(), &[None, Some(3)])?;
            let values: Vec<f64> = rows.into_iter().collect();
            Ok(values.chunks_exact(3).map(DVec3::from_slice).collect())
        };
        let points = read(POINTS)?;
        let normals = read(NORMALS).ok().filter(|normals| normals.len() == points.len());
        Self::new(points, normals, Vec::new(), unit).map_err(|error| match error {
            Error::Observation(message) => Error::format(path, message),
            other => other,
        })
    }

    /// Leaves out points that are not finite and the triangles at them.
    fn remove_not_finite(&mut self) -> Result<()> {
        let kept: Vec<bool> = self.points.iter().map(|point| point.is_finite()).collect();
        let count = kept.iter().filter(|&&kept| !kept).count();
        if count == 0 {
            return Ok(());
        }
        let share = count as f64 / kept.len() as f64;
        if share > MOST_REMOVED {
            let first = kept.iter().position(|&kept| !kept).unwrap_or_default();
            return Err(Error::Observation(format!(
                "scan: {count} of {} points ({:.0} %) are not finite, the first is point {first}; \
                 expected at most {:.0} %",
                kept.len(),
                100.0 * share,
                100.0 * MOST_REMOVED
            )));
        }
        let mut next = 0;
        let number: Vec<u32> = kept
            .iter()
            .map(|&kept| {
                next += u32::from(kept);
                next.saturating_sub(1)
            })
            .collect();
        let before = self.faces.len();
        self.faces.retain(|face| face.iter().all(|&at| kept[at as usize]));
        self.faces.iter_mut().for_each(|face| *face = face.map(|at| number[at as usize]));
        self.removed = RemovedElements { points: count, faces: before - self.faces.len() };
        self.points.retain(|point| point.is_finite());
        if let Some(normals) = &mut self.normals {
            let mut kept = kept.iter();
            normals.retain(|_| kept.next().is_none_or(|&kept| kept));
        }
        Ok(())
    }

    /// Brings the points to metres and checks their extent.
    fn rescale(&mut self, unit: ScanUnit) -> Result<()> {
        // Without 1 % outliers at each end.
        let extent = spread(&self.points, 0.01).max_element();
        let normalised = normalised(&self.points);
        (self.scale, self.remark) = match unit {
            ScanUnit::Known(unit) => {
                check_size(extent * unit.metres(), unit)?;
                (
                    unit.metres(),
                    remark(extent * unit.metres(), normalised.filter(|_| unit == Unit::M)),
                )
            }
            ScanUnit::OfAnySize(unit) => (unit.metres(), None),
            ScanUnit::Auto => found_scale(extent, normalised)?,
        };
        let scale = self.scale;
        self.points.iter_mut().for_each(|point| *point *= scale);
        Ok(())
    }

    /// Length of the file's unit, metres.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// Numbers of points that are not finite and of triangles at them, which were left out.
    pub fn removed(&self) -> RemovedElements {
        self.removed
    }

    /// Remark on an unusual size, or on the scale that was found out, a sentence.
    pub fn remark(&self) -> Option<&str> {
        self.remark.as_deref()
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

/// Size that the points have if they were scaled to a usual size of normalised scans.
fn normalised(points: &[DVec3]) -> Option<f64> {
    let (low, high) = points
        .iter()
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)));
    let extent = (high - low).max_element();
    NORMALISED.into_iter().find(|size| (extent / size - 1.0).abs() < 2e-3)
}

/// Remark on an extent, metres, that is possible but unusual.
fn remark(extent: f64, normalised: Option<f64>) -> Option<String> {
    if let Some(size) = normalised {
        return Some(format!(
            "the scan is exactly {size:.0} m in extent, as one that was scaled to unit size: the scale \
             goes into the shape; --unit auto scales it to {USUAL} m"
        ));
    }
    let [least, most] = ADULT;
    (!(least..=most).contains(&extent)).then(|| {
        format!(
            "the scan is {extent:.2} m in extent, unusual for an adult who stands ({least} to {most} m): \
             check its unit (--unit auto, m, cm or mm)"
        )
    })
}

/// Length of the unit, metres, of a scan of unknown unit with an extent in that unit, and a remark.
fn found_scale(extent: f64, normalised: Option<f64>) -> Result<(f64, Option<String>)> {
    if !(extent.is_finite() && extent > 0.0) {
        return Err(Error::Observation(format!(
            "scan: extent {extent}, expected that of a person"
        )));
    }
    if let Some(size) = normalised {
        let scale = USUAL / size;
        return Ok((scale, Some(format!("the scan was scaled to unit size: scaled to {USUAL} m"))));
    }
    for [least, most] in [ADULT, PERSON] {
        let fits = |unit: &&Unit| (least..=most).contains(&(extent * unit.metres()));
        if let Some(unit) = Unit::ALL.iter().find(fits) {
            let metres = extent * unit.metres();
            return Ok((
                unit.metres(),
                Some(format!("unit {}: {metres:.2} m in extent", unit.name())),
            ));
        }
    }
    let remark = format!("no unit gives {extent:.4} the extent of a person: scaled to {USUAL} m");
    Ok((USUAL / extent, Some(remark)))
}

/// An error unless the extent, metres, is that of a person, with a better unit if there is one.
fn check_size(extent: f64, unit: Unit) -> Result<()> {
    let [least, most] = PERSON;
    if (least..=most).contains(&extent) {
        return Ok(());
    }
    let units = extent / unit.metres();
    let fits = |other: &Unit| (least..=most).contains(&(units * other.metres()));
    let advice = match Unit::ALL.iter().find(|&other| *other != unit && fits(other)) {
        Some(other) => format!("use the unit {0} (--unit {0})", other.name()),
        None => "check that it contains one person, or scale it (--unit auto)".into(),
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
    fn point_clouds_of_archives_are_read() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("packed.npz");
        let write = |name: &str| {
            let points = cloud(1.0);
            let rows =
                ndarray::Array2::from_shape_fn((points.len(), 3), |(i, axis)| points[i][axis]);
            let mut file = cape_core::npy::NpzWriter::create(&path).unwrap();
            file.add(name, &rows).unwrap();
            file.finish().unwrap();
        };
        write("scan_pc");
        let scan = Scan::load(&path, Unit::M).unwrap();
        assert!(scan.points().iter().zip(cloud(1.0)).all(|(a, b)| a.distance(b) < 1e-9));
        assert_eq!(scan.points().len(), 600);
        write("points");
        let error = Scan::load(&path, Unit::M).unwrap_err().to_string();
        assert!(error.contains("packed.npz") && error.contains("has points"), "{error}");
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
        broken[7..38].iter_mut().for_each(|point| point.y = f64::NAN);
        let message = message(broken, Unit::M);
        assert!(message.contains("31 of 600 points (5 %) are not finite, the first is point 7"));
        let few = Scan::new(cloud(1.0), Some(vec![DVec3::X]), Vec::new(), Unit::M);
        assert!(few.unwrap_err().to_string().contains("1 normals"));
        let wrong = Scan::new(cloud(1.0), None, vec![[0, 1, 600]], Unit::M);
        assert!(wrong.unwrap_err().to_string().contains("[0, 1, 600]"));
        // Zero normals count as unknown.
        let zero = Scan::new(cloud(1.0), Some(vec![DVec3::ZERO; 600]), Vec::new(), Unit::M);
        assert_eq!(zero.unwrap().normals(), None);
    }

    #[test]
    fn points_that_are_not_finite_are_left_out_with_their_triangles() {
        let (mut points, faces) =
            (cloud(1.0), vec![[0, 1, 2], [2, 3, 4], [598, 9, 599], [7, 8, 9]]);
        let normals: Vec<DVec3> = (0..600).map(|i| DVec3::new(1.0, f64::from(i), 0.0)).collect();
        points[3].x = f64::NAN;
        points[8].z = f64::INFINITY;
        let scan = Scan::new(points.clone(), Some(normals.clone()), faces, Unit::M).unwrap();
        assert_eq!(scan.removed(), RemovedElements { points: 2, faces: 2 });
        assert_eq!(scan.faces(), [[0, 1, 2], [596, 7, 597]]);
        let kept: Vec<usize> = (0..600).filter(|i| ![3, 8].contains(i)).collect();
        for (new, &old) in kept.iter().enumerate() {
            assert_eq!(scan.points()[new], points[old]);
            assert_eq!(scan.normals().unwrap()[new], normals[old].normalize());
        }
    }

    #[test]
    fn unusual_sizes_are_remarked_and_scaled() {
        // As tall as cloud(1.0) is, in any unit.
        let tall = |metres: f64| {
            let points = cloud(1.0);
            let height = points.iter().fold(0f64, |most, p| most.max(p.y));
            points.into_iter().map(|p| p * (metres / height)).collect::<Vec<_>>()
        };
        let scan =
            |points: Vec<DVec3>, unit: ScanUnit| Scan::new(points, None, Vec::new(), unit).unwrap();
        let known = ScanUnit::Known(Unit::M);
        assert_eq!(scan(tall(1.75), known).remark(), None);
        let unit = scan(tall(1.0), known);
        assert!(unit.remark().unwrap().contains("exactly 1 m in extent"), "{:?}", unit.remark());
        assert!(scan(tall(2.0), known).remark().unwrap().contains("exactly 2 m"));
        assert!(scan(tall(1.1), known).remark().unwrap().contains("unusual for an adult"));
        for (size, metres) in [
            (1.75, 1.75),
            (175.0, 1.75),
            (1750.0, 1.75),
            (1.0, 1.7),
            (2.0, 1.7),
            (0.9, 0.9),
            (30.0, 1.7),
        ] {
            let found = scan(tall(size), ScanUnit::Auto);
            let height = found.points().iter().fold(0f64, |most, p| most.max(p.y));
            assert!((height / metres - 1.0).abs() < 0.03, "{size}: {height}");
            assert!((found.scale() * size - height).abs() < 1e-9);
            assert!(found.remark().is_some());
        }
    }

    #[test]
    fn units_are_known_by_their_signs() {
        assert!(Unit::ALL.iter().all(|unit| unit.name().parse::<Unit>().unwrap() == *unit));
        assert!("inch".parse::<Unit>().unwrap_err().to_string().contains("inch"));
    }
}

//! Registrations in the raw layout of the CAPE data set.

use std::path::{Path, PathBuf};

use cape_core::{ClothingMask, Outfit, SmplModel};
use cape_data::{
    SplitSpec,
    raw::{self, BODY_FILE, CLOTHING_FILE, RawFrame, SPLIT_FILE},
};
use glam::DVec3;
use ndarray::Array2;

use crate::{BodyParameters, Error, Result, parameters::POSE};

/// Tolerance of the rest shapes of one subject, metres.
const SAME: f64 = 1e-5;

/// Location of a frame in a raw data set.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FrameLocation {
    /// Subject.
    pub subject: String,
    /// Outfit.
    pub outfit: Outfit,
    /// Sequence.
    pub sequence: String,
    /// Number of the frame in the sequence.
    pub number: usize,
}

/// Registration of a frame: a clothed surface and the body under it.
///
/// ```
/// use cape_core::Outfit;
/// use cape_synth::synthetic_body;
/// use cape_fit::{BodyParameters, scan::{FrameLocation, Registration}};
/// use glam::DVec3;
///
/// // An unclothed body in its rest pose, raised by 1 m.
/// let body = synthetic_body();
/// let minimal = body.rest_shape(&[])?;
/// let mut parameters = BodyParameters::new(vec![0.0; 72], Vec::new())?;
/// parameters.transl = [0.0, 1.0, 0.0];
/// let rest = minimal.rows().into_iter().map(|v| DVec3::new(v[0], v[1], v[2]) + DVec3::Y);
/// let vertices: Vec<DVec3> = rest.collect();
/// let (body, minimal, parameters) = (&body, &minimal, &parameters);
/// let registration = Registration { body, minimal, parameters, vertices: &vertices };
/// let unposed = registration.frame()?.v_cano;
/// assert!((&unposed - minimal).iter().all(|gap| gap.abs() < 1e-9));
/// // Write it as a frame of a raw data set.
/// let (root, subject, sequence) = (tempfile::tempdir()?, "anna".into(), "scan".into());
/// let place = FrameLocation { subject, outfit: Outfit::LONG_LONG, sequence, number: 1 };
/// assert!(registration.write(&root.path().join("raw"), &place, &[100, 101])?.exists());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy)]
pub struct Registration<'a> {
    /// Body model.
    pub body: &'a SmplModel,
    /// Unclothed rest shape of the subject, metres, `[V, 3]`.
    pub minimal: &'a Array2<f64>,
    /// Pose and translation; shape coefficients are ignored in favour of `minimal`.
    pub parameters: &'a BodyParameters,
    /// Vertices of the clothed surface, metres, `[V]`.
    pub vertices: &'a [DVec3],
}

impl Registration<'_> {
    /// Raw frame with the posed and the canonical clothed surface.
    ///
    /// # Errors
    /// If sizes differ, or a vertex cannot be unposed.
    pub fn frame(&self) -> Result<RawFrame> {
        let rows: Vec<[f64; 3]> = self.vertices.iter().map(DVec3::to_array).collect();
        let v_posed = Array2::from(rows);
        let BodyParameters { transl, pose, .. } = self.parameters;
        let v_cano = self.body.unpose_shape(&v_posed, self.minimal, pose, *transl)?;
        let pose = pose.as_slice().try_into().map_err(|_| {
            Error::argument(format!("body: a pose of {} numbers, expected {POSE}", pose.len()))
        })?;
        Ok(RawFrame { v_cano, v_posed, pose, transl: *transl })
    }

    /// Writes the frame into the raw data set `root` and returns its path. A missing data set is
    /// created with the body, the clothing vertices `clothing` and a split with all frames in the
    /// training set.
    ///
    /// # Errors
    /// If a name is invalid, the subject has another rest shape in the data set, or a file cannot
    /// be read or written.
    pub fn write(&self, root: &Path, place: &FrameLocation, clothing: &[usize]) -> Result<PathBuf> {
        let FrameLocation { subject, outfit, sequence, number } = place;
        for (what, name) in [("subject", subject), ("sequence", sequence)] {
            let plain = |c: char| c.is_ascii_alphanumeric() || "_-".contains(c);
            if name.is_empty() || !name.chars().all(plain) {
                return Err(Error::argument(format!(
                    "{what} `{name}`, expected letters, digits, - and _"
                )));
            }
        }
        let frame = self.frame()?;
        let minimal_path = raw::minimal_path(root, subject);
        if minimal_path.exists() {
            let known = raw::read_minimal(root, subject)?;
            let same = known.dim() == self.minimal.dim()
                && known.iter().zip(self.minimal).all(|(a, b)| (a - b).abs() < SAME);
            if !same {
                return Err(Error::format(
                    minimal_path,
                    "differs from the rest shape of the fit: fit with it as the minimal shape of the \
                     subject",
                ));
            }
        } else {
            raw::write_minimal(root, subject, self.minimal)?;
        }
        if !root.join(BODY_FILE).exists() {
            self.body.save(root.join(BODY_FILE))?;
        }
        if !root.join(CLOTHING_FILE).exists() {
            let mask = ClothingMask::from_indices(self.body.vertices(), clothing)?;
            mask.save(root.join(CLOTHING_FILE))?;
        }
        let path = raw::write_frame(root, subject, *outfit, sequence, *number, &frame)?;
        add_to_split(&root.join(SPLIT_FILE), place)?;
        Ok(path)
    }
}

fn add_to_split(path: &Path, place: &FrameLocation) -> Result<()> {
    let mut split = if path.exists() {
        SplitSpec::from_file(path)?
    } else {
        SplitSpec { cut: 0, ..SplitSpec::default() }
    };
    let sequences = &mut split.train.sequences;
    let known = split.test.sequences.contains(&place.sequence);
    if !known && !sequences.contains(&place.sequence) {
        sequences.push(place.sequence.clone());
    }
    if !split.outfits.contains(&place.outfit) {
        split.outfits.push(place.outfit);
    }
    if !split.subjects.contains(&place.subject) {
        split.subjects.push(place.subject.clone());
    }
    let text = split.to_toml()?;
    Ok(cape_core::write_atomically(path, |file| {
        use std::io::Write;
        file.write_all(text.as_bytes())
    })?)
}

#[cfg(test)]
mod tests {
    use cape_data::{PackOptions, PackedSet, Split, pack};

    use super::*;
    use crate::testing::BODY;

    #[test]
    fn registrations_are_packed_as_they_were() {
        let pose = cape_synth::poses::preset("walk").unwrap().map(f64::from).to_vec();
        let mut parameters = BodyParameters::new(pose, vec![0.5, -1.0]).unwrap();
        parameters.transl = [0.3, 1.0, -2.0];
        let minimal = BODY.rest_shape(&parameters.betas).unwrap();
        let worn = Array2::from_shape_fn(minimal.dim(), |(v, axis)| {
            0.01 * ((v + 5 * axis) as f64 * 0.1).sin()
        });
        let BodyParameters { betas, pose, transl } = &parameters;
        let posed = BODY.pose(betas, pose, *transl, Some(&worn)).unwrap().vertices;
        let vertices: Vec<DVec3> =
            posed.rows().into_iter().map(|v| DVec3::new(v[0], v[1], v[2])).collect();
        let registration = Registration {
            body: &BODY,
            minimal: &minimal,
            parameters: &parameters,
            vertices: &vertices,
        };
        let root = tempfile::tempdir().unwrap();
        let tree = root.path().join("raw");
        let mut place = FrameLocation {
            subject: "ann".into(),
            outfit: Outfit::LONG_SHORT,
            sequence: "scan".into(),
            number: 1,
        };
        for number in 1..4 {
            place.number = number;
            registration.write(&tree, &place, &[1, 2, 3]).unwrap();
        }
        let split = SplitSpec::from_file(tree.join(SPLIT_FILE)).unwrap();
        let packed = root.path().join("packed");
        let options = PackOptions { strict: true, ..<_>::default() };
        pack(&tree, &packed, &split, options, &mut |_, _| {}).unwrap();
        let set = PackedSet::open(&packed, Split::Train).unwrap();
        assert_eq!(set.frames(), 3);
        let (displacement, packed_pose, _) = set.frame(0).unwrap();
        assert!((&displacement - &worn).iter().all(|d| d.abs() < 1e-9));
        assert_eq!(&packed_pose, pose);

        let other = BODY.rest_shape(&[1.0]).unwrap();
        let refused = Registration { minimal: &other, ..registration }.write(&tree, &place, &[1]);
        assert!(refused.unwrap_err().to_string().contains("differs from the rest shape"));
        place.subject = "../up".into();
        assert!(registration.write(&tree, &place, &[1]).is_err());
    }
}

//! Reconstructions of a few test frames, kept for pictures.

use std::path::Path;

use cape_core::{
    Outfit,
    npy::{Npz, NpzWriter},
};
use ndarray::{Array1, Array3, Ix3};

use crate::{
    Error, Result,
    data::{PackedSet, Part},
};

/// How many frames are shown.
const SHOWN: usize = 4;

/// The test frames of the packed set in `data` that are shown: of different outfits and captures
/// as far as there are any, from the middle of each.
pub fn shown_frames(data: &Path) -> Result<Vec<usize>> {
    let set = PackedSet::open(data, Part::Test)?;
    let frames = (0..set.frames()).map(|frame| (set.outfits()[frame], set.capture(frame)));
    Ok(spread(frames))
}

fn spread(frames: impl Iterator<Item = (Outfit, String)>) -> Vec<usize> {
    let mut captures: Vec<(Outfit, String, Vec<usize>)> = Vec::new();
    for (frame, (outfit, name)) in frames.enumerate() {
        match captures.iter_mut().find(|capture| (capture.0, &capture.1) == (outfit, &name)) {
            Some((.., frames)) => frames.push(frame),
            None => captures.push((outfit, name, vec![frame])),
        }
    }
    let of_outfit = |outfit| -> Vec<usize> {
        (0..captures.len()).filter(|&capture| captures[capture].0 == outfit).collect()
    };
    let outfits: Vec<Vec<usize>> =
        Outfit::ALL.into_iter().map(of_outfit).filter(|captures| !captures.is_empty()).collect();
    if outfits.is_empty() {
        return Vec::new();
    }
    // Each pick a little further on in its outfit's captures, so that movements differ too.
    let picks: Vec<usize> = (0..SHOWN)
        .map(|pick| {
            let captures = &outfits[pick % outfits.len()];
            captures[(2 * pick + 1) * captures.len() / (2 * SHOWN)]
        })
        .collect();
    let mut shown: Vec<usize> = Vec::new();
    for (pick, &capture) in picks.iter().enumerate() {
        let frames = &captures[capture].2;
        let same = |picks: &[usize]| picks.iter().filter(|&&other| other == capture).count();
        let (before, all) = (same(&picks[..pick]), same(&picks));
        let frame = frames[(2 * before + 1) * frames.len() / (2 * all)];
        if !shown.contains(&frame) {
            shown.push(frame);
        }
    }
    shown
}

/// Reconstructions of the frames shown, from the posterior's mean.
#[derive(Debug, Clone, PartialEq)]
pub struct Frames {
    /// Rows of the test frames.
    pub rows: Vec<usize>,
    /// Their displacements, metres, `[rows, V, 3]`.
    pub displacement: Array3<f32>,
}

impl Frames {
    /// Of frames that are still to come.
    pub(super) fn new(rows: &[usize], vertices: usize) -> Self {
        Self { rows: rows.to_vec(), displacement: Array3::zeros((rows.len(), vertices, 3)) }
    }

    /// Keeps a frame's displacements `[3 V]` if it is one of those shown.
    pub(super) fn see(&mut self, row: usize, predicted: &[f32]) {
        if let Some(index) = self.rows.iter().position(|&shown| shown == row) {
            let frame = self.displacement.index_axis_mut(ndarray::Axis(0), index);
            for (kept, &value) in frame.into_iter().zip(predicted) {
                *kept = value;
            }
        }
    }

    /// Writes `rows` and `displacement` as a `.npz` archive, atomically.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let mut file = NpzWriter::create(path)?;
        file.add("rows", &Array1::from_iter(self.rows.iter().map(|&row| row as i64)))?;
        file.add("displacement", &self.displacement)?;
        Ok(file.finish()?)
    }

    /// Reads what [`save`](Self::save) wrote.
    ///
    /// # Errors
    /// If an array is missing, has another shape, or numbers that cannot be; it is named.
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let mut file = Npz::open(path)?;
        let rows = file.i64("rows")?;
        file.expect_shape("rows", rows.shape(), &[None])?;
        let rows: Vec<usize> = rows
            .iter()
            .map(|&row| usize::try_from(row))
            .collect::<Result<_, _>>()
            .map_err(|_| Error::field(path, "rows", "has negative numbers"))?;
        let displacement = file.f32("displacement")?;
        let shape = [Some(rows.len()), None, Some(3)];
        file.expect_shape("displacement", displacement.shape(), &shape)?;
        if displacement.iter().any(|x| !x.is_finite()) {
            return Err(Error::field(path, "displacement", "has numbers that are not finite"));
        }
        let displacement = displacement
            .into_dimensionality::<Ix3>()
            .map_err(|error| Error::field(path, "displacement", error.to_string()))?;
        Ok(Self { rows, displacement })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spread_of(captures: &[(Outfit, &str, usize)]) -> Vec<usize> {
        spread(captures.iter().flat_map(|&(outfit, name, frames)| {
            std::iter::repeat_n((outfit, name.to_owned()), frames)
        }))
    }

    #[test]
    fn shown_frames_differ_in_outfit_and_capture() {
        let [a, b, c, d] = Outfit::ALL;
        let four = [(d, "jump", 5), (a, "jump", 5), (b, "jump", 5), (c, "jump", 5)];
        assert_eq!(spread_of(&four), [7, 12, 17, 2]);
        let eight = Outfit::ALL.map(|outfit| [(outfit, "hop", 1), (outfit, "sit", 1)]);
        assert_eq!(spread_of(eight.as_flattened()), [0, 2, 5, 7]);
        // One long capture: evenly.
        assert_eq!(spread_of(&[(a, "shortlong", 8)]), [1, 3, 5, 7]);
        assert_eq!(spread_of(&[(a, "shortlong", 3)]), [0, 1, 2]);
        assert_eq!(spread_of(&[]), [0; 0]);
    }

    #[test]
    fn frames_are_kept_and_checked() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("frames.npz");
        let mut frames = Frames::new(&[4, 1], 2);
        for row in 0..6 {
            frames.see(row, &[row as f32; 6]);
        }
        assert_eq!(frames.displacement[[0, 1, 2]], 4.0);
        assert_eq!(frames.displacement[[1, 0, 0]], 1.0);
        frames.save(&path).unwrap();
        assert_eq!(Frames::load(&path).unwrap(), frames);
        frames.see(1, &[f32::NAN; 6]);
        frames.save(&path).unwrap();
        assert!(Frames::load(&path).unwrap_err().to_string().contains("displacement"));
        frames.rows.pop();
        frames.save(&path).unwrap();
        assert!(Frames::load(&path).is_err());
    }
}

//! Reconstructions of a few test frames, kept for pictures.

use std::{collections::BTreeSet, path::Path};

use cape_core::{
    Outfit,
    npy::{Npz, NpzWriter},
};
use ndarray::{Array1, Array3, Ix3};

use crate::{Error, Result};
use cape_data::{PackedSet, Split};

/// Number of frames shown.
const SHOWN: usize = 4;

/// Outfit, subject and motion sequence of a frame, as far as they are known.
type SequenceKey = (Outfit, String, String);

/// The test frames of the packed set in `data` that are shown: of different outfits, movements and
/// subjects as far as there are any, from the middle of each capture.
pub fn select_frames(data: &Path) -> Result<Vec<usize>> {
    let set = PackedSet::open(data, Split::Test)?;
    let take = |frame: usize| {
        let (subject, sequence) = set.origins().map_or_else(Default::default, |origins| {
            (origins[frame].subject.clone(), origins[frame].sequence.clone())
        });
        (set.outfits()[frame], subject, sequence)
    };
    Ok(spread((0..set.frames()).map(take)))
}

fn spread(takes: impl Iterator<Item = SequenceKey>) -> Vec<usize> {
    let mut captures: Vec<(SequenceKey, Vec<usize>)> = Vec::new();
    for (frame, take) in takes.enumerate() {
        match captures.iter_mut().rfind(|(other, _)| *other == take) {
            Some((_, frames)) => frames.push(frame),
            None => captures.push((take, vec![frame])),
        }
    }
    let of_outfit = |outfit| -> Vec<usize> {
        (0..captures.len()).filter(|&capture| captures[capture].0.0 == outfit).collect()
    };
    let worn: BTreeSet<Outfit> = captures.iter().map(|(key, _)| key.0).collect();
    let outfits: Vec<Vec<usize>> = worn.into_iter().map(of_outfit).collect();
    if outfits.is_empty() {
        return Vec::new();
    }
    let mut picks: Vec<usize> = Vec::new();
    for pick in 0..SHOWN {
        let choice = &outfits[pick % outfits.len()];
        // Each pick looks from a little further on.
        let start = (2 * pick + 1) * choice.len() / (2 * SHOWN);
        let repeated = |&capture: &usize| {
            let (_, subject, sequence) = &captures[capture].0;
            let shown = picks.iter().map(|&other: &usize| &captures[other].0);
            shown.fold((0, 0), |(same_sequence, same_subject), other| {
                let same = (other.2 == *sequence, other.1 == *subject);
                (same_sequence + usize::from(same.0), same_subject + usize::from(same.1))
            })
        };
        let from_start = choice[start..].iter().chain(&choice[..start]).copied();
        picks.extend(from_start.min_by_key(repeated));
    }
    let mut shown: Vec<usize> = Vec::new();
    for (pick, &capture) in picks.iter().enumerate() {
        let frames = &captures[capture].1;
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
///
/// ```
/// use cape_eval::table2::FigureFrames;
/// use ndarray::Array3;
///
/// let frames = FigureFrames { rows: vec![2, 5], displacement: Array3::zeros((2, 10, 3)) };
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("frames.npz");
/// frames.save(&path)?;
/// assert_eq!(FigureFrames::load(&path)?, frames);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct FigureFrames {
    /// Rows of the test frames.
    pub rows: Vec<usize>,
    /// Their displacements, metres, `[rows, V, 3]`.
    pub displacement: Array3<f32>,
}

impl FigureFrames {
    /// Creates storage for the displacements of `rows`, filled by [`push`](Self::push).
    pub(super) fn new(rows: &[usize], vertices: usize) -> Self {
        Self { rows: rows.to_vec(), displacement: Array3::zeros((rows.len(), vertices, 3)) }
    }

    /// Keeps a frame's displacements `[3 V]` if it is one of those shown.
    pub(super) fn push(&mut self, row: usize, predicted: &[f32]) {
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

    fn spread_of(captures: &[(Outfit, &str, &str, usize)]) -> Vec<usize> {
        spread(captures.iter().flat_map(|&(outfit, subject, sequence, frames)| {
            std::iter::repeat_n((outfit, subject.to_owned(), sequence.to_owned()), frames)
        }))
    }

    #[test]
    fn shown_frames_differ_in_outfit_movement_and_subject() {
        let [a, b, c, d] = Outfit::PAPER;
        let four = [a, d, c, b].map(|outfit| (outfit, "ann", "jump", 5));
        assert_eq!(spread_of(&four), [2, 17, 12, 7]);
        let mut captures = Vec::new();
        for outfit in [a, b] {
            for subject in ["ann", "bob"] {
                captures.extend(["hop", "sit"].map(|sequence| (outfit, subject, sequence, 1)));
            }
        }
        // Ann hops, Bob sits, and in turn.
        assert_eq!(spread_of(&captures), [0, 7, 2, 5]);
        // One long capture: evenly.
        assert_eq!(spread_of(&[(a, "", "", 8)]), [1, 3, 5, 7]);
        assert_eq!(spread_of(&[(a, "", "", 3)]), [0, 1, 2]);
        assert_eq!(spread_of(&[]), [0; 0]);
    }

    #[test]
    fn frames_are_kept_and_checked() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("frames.npz");
        let mut frames = FigureFrames::new(&[4, 1], 2);
        for row in 0..6 {
            frames.push(row, &[row as f32; 6]);
        }
        assert_eq!(frames.displacement[[0, 1, 2]], 4.0);
        assert_eq!(frames.displacement[[1, 0, 0]], 1.0);
        frames.save(&path).unwrap();
        assert_eq!(FigureFrames::load(&path).unwrap(), frames);
        frames.push(1, &[f32::NAN; 6]);
        frames.save(&path).unwrap();
        assert!(FigureFrames::load(&path).unwrap_err().to_string().contains("displacement"));
        frames.rows.pop();
        frames.save(&path).unwrap();
        assert!(FigureFrames::load(&path).is_err());
    }
}

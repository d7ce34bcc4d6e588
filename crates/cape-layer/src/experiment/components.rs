//! Reconstruction error by the number of principal components (figure 3 of the paper).

use ndarray::{Axis, s};
use serde::{Deserialize, Serialize};

use super::{LayerError, UnposedSet};
use crate::{ComponentSelection, Pca, Result, Sequence};

/// Numbers of components of the curve.
const COUNTS: [usize; 13] = [1, 2, 3, 5, 7, 10, 15, 20, 30, 40, 60, 80, 100];

/// Every fifth frame is held out of the components of the others.
const HELD_OUT: usize = 5;

/// Mean reconstruction error over the sequences of a set by the number of principal components of each.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ComponentCurve {
    /// Name of the set.
    pub set: String,
    /// Numbers of components, ascending.
    pub components: Vec<usize>,
    /// Error of all frames with the components of all frames, millimetres.
    pub own_mm: Vec<f64>,
    /// Error of every fifth frame with the components of the other frames, millimetres.
    pub held_out_mm: Vec<f64>,
}

impl ComponentCurve {
    /// Measures the curve of a set with the name `name`, up to as many components as the shortest
    /// sequence has. `progress` is called with the number of measured sequences.
    ///
    /// # Errors
    /// If a sequence has fewer than two frames.
    pub fn measure(
        name: &str,
        set: &UnposedSet<'_>,
        progress: &mut dyn FnMut(usize),
    ) -> Result<Self> {
        let sequences = set.set().sequences.len();
        let shortest = set.set().sequences.iter().map(Sequence::frames).min().unwrap_or(0);
        let most = shortest - shortest.div_ceil(HELD_OUT);
        let counts: Vec<usize> = COUNTS.into_iter().filter(|&count| count < most).collect();
        let mut own = vec![0.0; counts.len()];
        let mut held_out = vec![0.0; counts.len()];
        for sequence in 0..sequences {
            let errors = set.reconstruction_of(sequence, &counts)?;
            let held = held_out_errors(set, sequence, &counts)?;
            for (sums, errors) in [(&mut own, errors), (&mut held_out, held)] {
                for (sum, error) in sums.iter_mut().zip(errors) {
                    *sum += error.mean / sequences as f64;
                }
            }
            progress(sequence + 1);
        }
        Ok(Self { set: name.to_owned(), components: counts, own_mm: own, held_out_mm: held_out })
    }
}

/// Errors of every fifth frame of a sequence with the components of the others, `[counts]`.
fn held_out_errors(
    set: &UnposedSet<'_>,
    sequence: usize,
    counts: &[usize],
) -> Result<Vec<LayerError>> {
    let (frames, _) = set.frames_of(&[sequence]);
    let of = |held: bool| -> Vec<usize> {
        let is_chosen = |number: usize| number.is_multiple_of(HELD_OUT) == held;
        let chosen = frames.iter().enumerate().filter(|(number, _)| is_chosen(*number));
        chosen.map(|(_, &frame)| frame).collect()
    };
    let (held, known) = (of(true), of(false));
    if counts.is_empty() {
        return Ok(Vec::new());
    }
    let all =
        Pca::from_snapshots(set.rows.select(Axis(0), &known).view(), ComponentSelection::All)?;
    let codes = all.encode(set.rows.select(Axis(0), &held).view())?;
    let error = |&count: &usize| {
        let pca = all.truncated(count);
        let offsets = pca.decode(codes.slice(s![.., ..pca.latent()]))?;
        Ok(LayerError::over(&set.errors(&held, offsets.view())?))
    };
    counts.iter().map(error).collect()
}

#[cfg(test)]
mod tests {
    use cape_core::smpl::StandardPose;
    use cape_synth::synthetic_body;

    use super::*;
    use crate::experiment::tests::march;

    #[test]
    fn errors_fall_with_the_number_of_components() {
        let model = synthetic_body();
        let (set, association) = march(&model);
        let unposed =
            UnposedSet::new(&model, &set, &association, &StandardPose::default()).unwrap();
        let mut measured = 0;
        let curve = ComponentCurve::measure("m", &unposed, &mut |done| measured = done).unwrap();
        assert_eq!((measured, &curve.components[..3]), (1, &[1, 2, 3][..]));
        assert_eq!(curve.components.last(), Some(&40), "48 frames are known");
        for errors in [&curve.own_mm, &curve.held_out_mm] {
            let falls = |before: &f64, after: &f64| *after < 1.02 * before + 1e-6;
            assert!(errors.is_sorted_by(falls), "{curve:?}");
            assert!(errors[0] > 1.0 && errors[9] < 0.1 * errors[0], "{curve:?}");
        }
        // The row of table 1.
        let table = unposed.reconstruction(&[1, 5, 20]).unwrap();
        for (at, error) in [0, 3, 7].into_iter().zip(&table[0]) {
            assert!((curve.own_mm[at] - error.mean).abs() < 1e-9, "{curve:?}");
        }
        assert!(curve.held_out_mm[3] > curve.own_mm[3], "{curve:?}");
    }
}

//! Translations, shape and what is left out of one of the people of a dictionary.

use std::path::Path;

use ndarray::{Array2, ArrayD, Axis};

use super::{
    clip::Clip,
    content::Entry,
    names::{BETAS, BODIES, Fields, LEFT_OUT, TRANSLATIONS, find, numbers},
};
use crate::{Error, Result};

/// Reader of what belongs to one of several people.
pub(super) struct PersonReader<'e, 'a> {
    pub(super) path: &'e Path,
    pub(super) fields: &'e Fields<'a>,
    pub(super) person: usize,
    pub(super) people: usize,
}

impl PersonReader<'_, '_> {
    /// Rows `[frames or 1, columns]` of an array `[frames?, columns]`, of one with people first if
    /// there are several.
    fn rows(&self, array: &ArrayD<f64>, frames: usize) -> Option<Array2<f64>> {
        let (&columns, lead) = array.shape().split_last()?;
        let lead: Vec<usize> = match lead {
            [people, frames, 1] => vec![*people, *frames],
            _ => lead.to_vec(),
        };
        let own = match lead[..] {
            [people, rows] if people == self.people && (self.people > 1 || rows == frames) => rows,
            [rows, 1] if self.people == 1 => rows,
            [people] if self.people > 1 && people == self.people => 1,
            [rows] if self.people == 1 => rows,
            [] => 1,
            _ => return None,
        };
        let several = self.people > 1 && !lead.is_empty();
        let before = if several { self.person * own * columns } else { 0 };
        let numbers = array.iter().copied().skip(before).take(own * columns).collect();
        Array2::from_shape_vec((own, columns), numbers).ok()
    }

    /// Reads translations, which a scale of the body divides.
    pub(super) fn translation(&self, clip: &mut Clip) -> Result<()> {
        let Some(named) = numbers(self.fields, &TRANSLATIONS) else { return Ok(()) };
        let fault = |message| Error::field(self.path, named.name, message);
        let mut array = named.numbers.read()?;
        let frames = clip.frames();
        if array.shape() == [3, frames] && frames != 3 {
            array = array.reversed_axes().as_standard_layout().into_owned();
        }
        let rows = self.rows(&array, frames).filter(|rows| rows.dim() == (frames, 3));
        let mut rows = rows.ok_or_else(|| {
            fault(format!("shape {:?}, expected [{frames}, 3] as there are poses", array.shape()))
        })?;
        self.divide_by_scale(&mut rows, clip)?;
        if let Some(at) = rows.iter().position(|x| !x.is_finite()) {
            return Err(fault(format!("number {} of frame {} is not finite", at % 3, at / 3)));
        }
        clip.translations = Some(rows);
        Ok(())
    }

    /// Divides translations `[frames, 3]` by the scale of the body: AIST++, THuman and NeuMan place a
    /// scaled body, `s x + t`; a body of SMPL's size moves by as much less.
    fn divide_by_scale(&self, translations: &mut Array2<f64>, clip: &mut Clip) -> Result<()> {
        // `scale` is that of an image elsewhere.
        let split = BODIES.iter().any(|name| find(self.fields, name).is_some());
        let names: &[&'static str] =
            if split { &["smpl_scaling", "scale"] } else { &["smpl_scaling"] };
        let Some(named) = numbers(self.fields, names) else { return Ok(()) };
        let scales: Vec<f64> = named.numbers.read()?.iter().copied().collect();
        if scales.len() != 1 && scales.len() != translations.nrows() {
            return Ok(());
        }
        if let Some(scale) = scales.iter().find(|scale| !(scale.is_finite() && **scale > 0.0)) {
            let message = format!("{scale}: expected a positive number");
            return Err(Error::field(self.path, named.name, message));
        }
        for (mut row, &scale) in translations.rows_mut().into_iter().zip(scales.iter().cycle()) {
            row /= scale;
        }
        if scales.iter().any(|scale| (scale - 1.0).abs() > 1e-6) {
            clip.notes.push(format!(
                "the body is scaled by {} in the file (`{}`): its way is divided by that",
                scales[0], named.name
            ));
        }
        Ok(())
    }

    /// Reads shape coefficients, of which the mean over rows is taken.
    pub(super) fn betas(&self, clip: &mut Clip) -> Result<()> {
        let Some(named) = numbers(self.fields, &BETAS) else { return Ok(()) };
        // `shape` may be another's, such as that of an image.
        if named.name.starts_with("shape") && named.numbers.shape.last().is_none_or(|&n| n < 8) {
            return Ok(());
        }
        let array = named.numbers.read()?;
        let Some(rows) = self.rows(&array, clip.frames()) else {
            clip.notes.push(format!("betas of shape {:?} are left out", array.shape()));
            return Ok(());
        };
        let mean = rows.mean_axis(Axis(0)).map(|mean| mean.to_vec()).unwrap_or_default();
        if mean.iter().any(|beta| !beta.is_finite()) {
            return Err(Error::field(self.path, named.name, "a coefficient is not finite"));
        }
        (clip.betas, clip.shapes) = (mean, rows.nrows());
        Ok(())
    }

    /// Counts what the body has not.
    pub(super) fn left_out(&self, clip: &mut Clip) {
        for (name, what, each) in LEFT_OUT {
            let Some(Entry::Numbers(numbers)) = find(self.fields, name) else { continue };
            let skip = usize::from(numbers.shape.len() > 1);
            let count: usize = numbers.shape.iter().skip(skip).product::<usize>() / each;
            let counted = clip.left_out.iter().any(|(known, _)| *known == what) && clip.joints > 24;
            if count > 0 && !counted {
                match clip.left_out.iter_mut().find(|(known, _)| *known == what) {
                    Some((_, total)) => *total += count,
                    None => clip.left_out.push((what, count)),
                }
            }
        }
    }
}

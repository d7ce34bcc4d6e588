//! Variation of the clothing in a packed set: size of the displacements, principal components,
//! dependence on the pose, repetitions of a pose, and wrinkles.

mod components;
mod frames;
mod pose;
mod wrinkles;

use std::path::Path;

use cape_core::{ProgressFn, SmplModel};
use cape_data::{DisplacementStatistics, PackedSet, Split};
use serde::Serialize;

pub use components::ComponentError;
pub use pose::{PoseVariance, RepeatedPoses};
pub use wrinkles::Wrinkles;

use crate::{Error, Result};
use frames::ClothingFrames;

/// Options of [`ClothingStatistics::measure`].
///
/// ```
/// use cape_eval::clothing_statistics::ClothingStatisticsOptions;
///
/// // A thousand frames of each part need about 170 MB.
/// assert_eq!(ClothingStatisticsOptions::default().frames, 1000);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct ClothingStatisticsOptions {
    /// Largest number of training frames, and of test frames, that are read.
    pub frames: usize,
    /// Statistics of another set, such as the release's `trainset_stats.npz`, that mean and deviation
    /// are compared with.
    pub reference: Option<DisplacementStatistics>,
    /// Clothing vertices of the reference; `None` if they are those of the set.
    pub reference_clothing: Option<Vec<usize>>,
}

impl Default for ClothingStatisticsOptions {
    fn default() -> Self {
        Self { frames: 1000, reference: None, reference_clothing: None }
    }
}

/// Variation of the clothing in a packed set, at its clothing vertices in canonical space.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClothingStatistics {
    /// Number of training and test frames that were read.
    pub frames: [usize; 2],
    /// Median over the vertices of the mean training displacement's absolute value along x, y, z,
    /// millimetres.
    pub mean_mm: [f64; 3],
    /// Median over the vertices of the standard deviation along x, y, z, millimetres.
    pub std_mm: [f64; 3],
    /// The same of the reference.
    pub reference: Option<ReferenceStatistics>,
    /// Errors of principal components of the training frames on the test frames.
    pub components: Vec<ComponentError>,
    /// Dependence on the pose within captures; `None` if captures are unknown or short.
    pub pose: Option<PoseVariance>,
    /// Frames of the same pose in different captures of the same garments; `None` if there are none.
    pub repeats: Option<RepeatedPoses>,
    /// Wrinkles of the test frames.
    pub wrinkles: Wrinkles,
}

/// Sizes of displacements in other statistics, millimetres, and ratios to them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ReferenceStatistics {
    /// As [`ClothingStatistics::mean_mm`].
    pub mean_mm: [f64; 3],
    /// As [`ClothingStatistics::std_mm`].
    pub std_mm: [f64; 3],
    /// Mean of the set over that of the reference.
    pub mean_ratio: [f64; 3],
    /// Deviation of the set over that of the reference.
    pub std_ratio: [f64; 3],
}

impl ClothingStatistics {
    /// Measures the packed set in `data` at the vertices `clothing` of `body`.
    ///
    /// # Errors
    /// If a part is missing or unreadable, it has other vertices than the body, or fewer than two
    /// frames.
    ///
    /// ```
    /// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/../cape-train/doc/sets.rs"));
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// use cape_core::{SmplModel, silent};
    /// use cape_eval::clothing_statistics::{ClothingStatistics, ClothingStatisticsOptions};
    ///
    /// let directory = captures()?;
    /// let data = directory.path().join("packed");
    /// let body = SmplModel::load(data.join("body.npz"))?;
    /// let clothing: Vec<usize> = (0..body.vertices()).collect();
    /// let options = ClothingStatisticsOptions::default();
    /// let found = ClothingStatistics::measure(&data, &body, &clothing, &options, &mut silent)?;
    /// // One of the four training frames is for validation.
    /// assert_eq!(found.frames, [3, 4]);
    /// assert!(found.wrinkles.fine_mm > 0.0);
    /// # Ok(())
    /// # }
    /// ```
    pub fn measure(
        data: impl AsRef<Path>,
        body: &SmplModel,
        clothing: &[usize],
        options: &ClothingStatisticsOptions,
        progress: &mut ProgressFn,
    ) -> Result<Self> {
        let data = data.as_ref();
        let open = |part: Split| -> Result<PackedSet> {
            let set = PackedSet::open(data, part)?;
            if set.vertices() != body.vertices() {
                return Err(Error::argument(format!(
                    "{}: frames of {} vertices, but the body has {}",
                    data.display(),
                    set.vertices(),
                    body.vertices()
                )));
            }
            Ok(set)
        };
        let [train, test] = [open(Split::Train)?, open(Split::Test)?];
        let statistics = DisplacementStatistics::from_packed(data, &mut cape_core::silent)?;
        let sizes = |of: &DisplacementStatistics, clothing: &[usize]| {
            [of.mean(), of.std()].map(|rows| {
                [0, 1, 2].map(|axis| {
                    1000.0 * median(clothing.iter().map(|&v| rows[(v, axis)].abs()).collect())
                })
            })
        };
        let [mean_mm, std_mm] = sizes(&statistics, clothing);
        let reference = match &options.reference {
            None => None,
            Some(reference) => {
                let worn = options.reference_clothing.as_deref().unwrap_or(clothing);
                let most = worn.iter().max().map_or(0, |&vertex| vertex + 1);
                if reference.vertices() < most {
                    return Err(Error::argument(format!(
                        "reference statistics of {} vertices, but a clothing vertex is {}",
                        reference.vertices(),
                        most - 1
                    )));
                }
                let [mean, std] = sizes(reference, worn);
                let ratio = |a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|axis| a[axis] / b[axis]);
                Some(ReferenceStatistics {
                    mean_mm: mean,
                    std_mm: std,
                    mean_ratio: ratio(mean_mm, mean),
                    std_ratio: ratio(std_mm, std),
                })
            }
        };
        let rows: Vec<usize> = statistics.training_rows(train.frames()).collect();
        let steps = 5;
        let training = ClothingFrames::spread(&train, &rows, clothing, options.frames)?;
        progress(1, steps);
        let all: Vec<usize> = (0..test.frames()).collect();
        let held_out = ClothingFrames::spread(&test, &all, clothing, options.frames)?;
        progress(2, steps);
        let components = components::errors(&training, &held_out)?;
        progress(3, steps);
        let captures = frames::captures(&train, clothing, options.frames)?;
        let pose = PoseVariance::measure(&captures);
        progress(4, steps);
        let repeats = RepeatedPoses::measure(&captures);
        let wrinkles = Wrinkles::measure(&test, body, clothing, 200)?;
        progress(5, steps);
        Ok(Self {
            frames: [training.rows.nrows(), held_out.rows.nrows()],
            mean_mm,
            std_mm,
            reference,
            components,
            pose,
            repeats,
            wrinkles,
        })
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

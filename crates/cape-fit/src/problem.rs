use std::fmt;

use serde::{Deserialize, Serialize};

/// Reason why a fit is unreliable.
///
/// ```
/// use cape_fit::FitProblem;
///
/// let problem = FitProblem::JointError { error_mm: 120.0, limit_mm: 100.0 };
/// assert_eq!(problem.to_string(), "mean joint error 120 mm, expected at most 100 mm");
/// // Files of earlier versions hold the text alone.
/// let read: FitProblem = serde_json::from_str("\"the body has left the image\"")?;
/// assert!(matches!(read, FitProblem::Failed(_)));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum FitProblem {
    /// The joints are too far from their detections.
    JointError {
        /// Mean distance at the distance of the person, millimetres.
        error_mm: f64,
        /// Largest accepted distance, millimetres.
        limit_mm: f64,
    },
    /// Too much of the rendered silhouette is beside the mask.
    BesideMask {
        /// Share of the rendered silhouette on the mask, 0 to 1.
        share: f64,
        /// Least accepted share.
        limit: f64,
    },
    /// Too much of the mask is not covered by the rendered silhouette.
    Unexplained {
        /// Share of the mask that the rendered silhouette covers, 0 to 1.
        share: f64,
        /// Least accepted share.
        limit: f64,
    },
    /// The rendered silhouette differs too much from the mask; in files of earlier versions.
    Silhouette {
        /// Intersection over union, 0 to 1.
        intersection_over_union: f64,
        /// Least accepted value.
        limit: f64,
    },
    /// The scan is too far from the surface.
    ScanDistance {
        /// Median distance of the points of the scan, millimetres.
        median_mm: f64,
        /// Largest accepted median, millimetres.
        limit_mm: f64,
    },
    /// Too many points of the scan are far from the surface.
    ScanOutliers {
        /// 95th percentile of the distances of the points of the scan, millimetres.
        percentile_95_mm: f64,
        /// Largest accepted percentile, millimetres.
        limit_mm: f64,
    },
    /// The optimisation failed, with the reason.
    #[serde(untagged)]
    Failed(String),
}

impl fmt::Display for FitProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::JointError { error_mm, limit_mm } => {
                write!(f, "mean joint error {error_mm:.0} mm, expected at most {limit_mm:.0} mm")
            }
            Self::BesideMask { share, limit } => write!(
                f,
                "{:.1} % of the fitted silhouette is on the mask, expected at least {:.0} %",
                100.0 * share,
                100.0 * limit
            ),
            Self::Unexplained { share, limit } => write!(
                f,
                "the fitted silhouette covers {:.1} % of the mask, expected at least {:.0} %",
                100.0 * share,
                100.0 * limit
            ),
            Self::Silhouette { intersection_over_union, limit } => write!(
                f,
                "intersection over union of the silhouettes {intersection_over_union:.3}, expected at \
                 least {limit}"
            ),
            Self::ScanDistance { median_mm, limit_mm } => write!(
                f,
                "median distance of the scan from the surface {median_mm:.1} mm, expected at most \
                 {limit_mm:.0} mm"
            ),
            Self::ScanOutliers { percentile_95_mm, limit_mm } => write!(
                f,
                "95th percentile of the distances of the scan from the surface {percentile_95_mm:.0} \
                 mm, expected at most {limit_mm:.0} mm"
            ),
            Self::Failed(reason) => f.write_str(reason),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn problems_are_read_back() {
        let problems = [
            FitProblem::JointError { error_mm: 120.0, limit_mm: 100.0 },
            FitProblem::BesideMask { share: 0.5, limit: 0.9 },
            FitProblem::Unexplained { share: 0.5, limit: 0.7 },
            FitProblem::Silhouette { intersection_over_union: 0.5, limit: 0.85 },
            FitProblem::ScanDistance { median_mm: 20.0, limit_mm: 12.0 },
            FitProblem::ScanOutliers { percentile_95_mm: 200.0, limit_mm: 80.0 },
            FitProblem::Failed("the body has left the image".into()),
        ];
        for problem in problems {
            let text = serde_json::to_string(&problem).unwrap();
            assert_eq!(serde_json::from_str::<FitProblem>(&text).unwrap(), problem, "{text}");
        }
    }
}

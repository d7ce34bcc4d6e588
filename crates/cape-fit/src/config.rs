use serde::{Deserialize, Serialize};

use crate::{ClothedConfig, Result, SmplifyConfig};

/// Configuration of a fit to an image.
///
/// ```
/// use cape_fit::{ClothedConfig, FitConfig, SilhouetteLevel};
///
/// // Compare silhouettes at one scale only.
/// let levels = vec![SilhouetteLevel { side: 128, rounds: 4, steps: 10 }];
/// let config = FitConfig {
///     clothed: ClothedConfig { levels, ..ClothedConfig::default() },
///     ..FitConfig::default()
/// };
/// config.check()?;
/// // Negative weights are refused.
/// let clothed = ClothedConfig { code: -1.0, ..config.clothed };
/// let refused = FitConfig { clothed, ..config }.check().unwrap_err();
/// assert!(refused.to_string().contains("code"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FitConfig {
    /// Configuration of the unclothed fit.
    pub smplify: SmplifyConfig,
    /// Configuration of the clothed fit.
    pub clothed: ClothedConfig,
}

impl FitConfig {
    /// Checks the ranges of all fields.
    ///
    /// # Errors
    /// If a field is out of range; the error has its name.
    pub fn check(&self) -> Result<()> {
        self.smplify.check()?;
        self.clothed.check()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_fields_have_defaults() {
        let text = r#"{"clothed": {"silhouette": 2e4, "body": {"pose": 0.5}}}"#;
        let config: FitConfig = serde_json::from_str(text).unwrap();
        config.check().unwrap();
        assert_eq!(config.smplify, SmplifyConfig::default());
        assert_eq!((config.clothed.silhouette, config.clothed.body.pose), (2e4, 0.5));
        assert_eq!(config.clothed.levels, ClothedConfig::default().levels);
        assert!(serde_json::from_str::<FitConfig>(r#"{"clothing": {}}"#).is_err());
        let negative: FitConfig = serde_json::from_str(r#"{"clothed": {"code": -1}}"#).unwrap();
        assert!(negative.check().unwrap_err().to_string().contains("code"));
    }
}

use cape_core::SmplModel;
use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Body that a set or a layer belongs to: its name and the SHA-256 of its arrays.
///
/// ```
/// use cape_layer::BodyIdentity;
/// use cape_synth::synthetic_body;
///
/// let mut body = synthetic_body();
/// let identity = BodyIdentity::new("synthetic body", &body);
/// assert!(identity.check("skirt", &body).is_ok());
/// body.v_template *= 1.01;
/// let error = identity.check("skirt", &body).unwrap_err();
/// assert!(error.to_string().contains("another body"));
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BodyIdentity {
    /// Name, a file name for example.
    pub name: String,
    /// SHA-256 of the body's arrays ([`SmplModel::sha256`]), hexadecimal.
    pub sha256: String,
}

impl BodyIdentity {
    /// Identity of `model`.
    pub fn new(name: impl Into<String>, model: &SmplModel) -> Self {
        Self { name: name.into(), sha256: model.sha256() }
    }

    /// Checks that `model` is this body; `owner` is what belongs to it.
    ///
    /// # Errors
    /// If it is another one.
    pub fn check(&self, owner: &str, model: &SmplModel) -> Result<()> {
        let found = model.sha256();
        if found == self.sha256 {
            return Ok(());
        }
        Err(Error::argument(format!(
            "{owner} is of another body, `{}` (SHA-256 {}, this one is {}): give that body by --body",
            self.name,
            self.sha256.get(..12).unwrap_or(&self.sha256),
            &found[..12]
        )))
    }
}

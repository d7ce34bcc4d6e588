//! The rows of the table and their configurations.

use cape_model::{DecoderBlock, DecoderConditions, LossConfig};
use serde::{Deserialize, Serialize};

use crate::{Error, Result};
use cape_infer::RunConfig;

/// A row of the table.
///
/// ```
/// use cape_eval::table2::Table2Row;
/// use cape_infer::RunConfig;
///
/// let row: Table2Row = "no-discriminator".parse()?;
/// let config = row.configure(&RunConfig::default());
/// assert!(config.model.discriminator.is_none());
/// assert!(row.is_trained() && !Table2Row::Mean.is_trained());
/// # Ok::<(), cape_train::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Table2Row {
    /// The mean training displacement in place of every frame.
    Mean,
    /// Principal components.
    Pca,
    /// CoMA with four-fold down-sampling.
    #[serde(rename = "coma-4")]
    Coma4,
    /// CoMA without down-sampling.
    #[serde(rename = "coma-1")]
    Coma1,
    /// CAPE.
    Cape,
    /// CAPE with affine blocks in the decoder.
    CapeAffine,
    /// CAPE without discriminator.
    NoDiscriminator,
    /// CAPE without residual blocks.
    NoResidual,
    /// CAPE without edge loss.
    NoEdge,
}

impl Table2Row {
    /// All rows, in the table's order.
    pub const ALL: [Self; 9] = [
        Self::Mean,
        Self::Pca,
        Self::Coma4,
        Self::Coma1,
        Self::Cape,
        Self::CapeAffine,
        Self::NoDiscriminator,
        Self::NoResidual,
        Self::NoEdge,
    ];

    /// Its name in commands and directories.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::Pca => "pca",
            Self::Coma4 => "coma-4",
            Self::Coma1 => "coma-1",
            Self::Cape => "cape",
            Self::CapeAffine => "cape-affine",
            Self::NoDiscriminator => "no-discriminator",
            Self::NoResidual => "no-residual",
            Self::NoEdge => "no-edge",
        }
    }

    /// Its name in the table.
    pub const fn label(self) -> &'static str {
        match self {
            Self::Mean => "mean shape",
            Self::Pca => "PCA",
            Self::Coma4 => "CoMA-4",
            Self::Coma1 => "CoMA-1",
            Self::Cape => "CAPE",
            Self::CapeAffine => "CAPE-affine",
            Self::NoDiscriminator => "w/o discriminator",
            Self::NoResidual => "w/o residual block",
            Self::NoEdge => "w/o edge loss",
        }
    }

    /// True if the row is trained by gradients and depends on the seed.
    pub const fn is_trained(self) -> bool {
        !matches!(self, Self::Mean | Self::Pca)
    }

    /// The configuration of this row: that of CAPE with one switch set another way; for CoMA the
    /// same encoder, latent size and training, without conditions and with the reconstruction loss
    /// only.
    pub fn configure(self, cape: &RunConfig) -> RunConfig {
        let mut config = cape.clone();
        let RunConfig { model, loss, .. } = &mut config;
        match self {
            Self::Mean | Self::Pca | Self::Cape => {}
            Self::CapeAffine => model.decoder = DecoderBlock::Affine,
            Self::NoDiscriminator => {
                model.discriminator = None;
                loss.gan = 0.0;
            }
            Self::NoResidual => model.decoder = DecoderBlock::Plain,
            Self::NoEdge => loss.edge = 0.0,
            Self::Coma4 | Self::Coma1 => {
                model.decoder = DecoderBlock::Plain;
                model.decoder_conditions = DecoderConditions::None;
                model.encoder_conditions = false;
                model.pose_embedding = 0;
                model.outfit_embedding = 0;
                model.variational = false;
                model.discriminator = None;
                // Where CAPE halves the mesh, and after the last layer, CoMA-4 quarters it.
                let layers = model.factors.len();
                for (layer, factor) in model.factors.iter_mut().enumerate() {
                    let pools = *factor > 1 || layer + 1 == layers;
                    *factor = if pools && self == Self::Coma4 { 4 } else { 1 };
                }
                *loss = LossConfig { edge: 0.0, kl: 0.0, gan: 0.0, ..loss.clone() };
            }
        }
        config
    }
}

impl std::str::FromStr for Table2Row {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|row| row.name() == text).ok_or_else(|| {
            let names: Vec<&str> = Self::ALL.iter().map(|row| row.name()).collect();
            Error::argument(format!("unknown row `{text}`: expected {}", names.join(", ")))
        })
    }
}

#[cfg(test)]
mod tests {
    use cape_model::CapeConfig;

    use super::*;

    #[test]
    fn every_row_is_a_valid_configuration_and_differs_by_its_switch() {
        let cape = RunConfig::default();
        for row in Table2Row::ALL {
            let config = row.configure(&cape);
            config.validate().unwrap();
            assert_eq!(config.train, cape.train);
            assert_eq!(
                config == cape,
                matches!(row, Table2Row::Cape | Table2Row::Mean | Table2Row::Pca),
                "{row:?}"
            );
            assert_eq!(row.name().parse::<Table2Row>().unwrap(), row);
            assert_eq!(serde_json::to_string(&row).unwrap(), format!("\"{}\"", row.name()));
        }
        assert!("kilt".parse::<Table2Row>().unwrap_err().to_string().contains("coma-4"));
        let of = |row: Table2Row| row.configure(&cape).model;
        assert_eq!(of(Table2Row::Coma4).factors, [1, 4, 1, 4, 1, 4, 1, 4]);
        assert_eq!(of(Table2Row::Coma1).factors, [1; 8]);
        assert_eq!(of(Table2Row::Coma1).latent, CapeConfig::paper().latent);
        assert_eq!(of(Table2Row::Coma4).filters, CapeConfig::paper().filters);
    }
}

//! Names of the release's variables for the parameters of this crate.

use crate::{
    CapeConfig, DecoderBlock, Error, Result,
    weights::{HostArray, Weights},
};

/// Weights of a model under the release's names, with suffix `:0` and the release's shapes.
///
/// Residual encoder blocks do not occur in the release's default configurations; their names follow
/// the pattern of the decoder's, and [`import`](super::import) reads them.
///
/// # Errors
/// If the discriminator has spectral normalisation, or a weight is not a parameter of the
/// configuration; it is named.
pub fn export(config: &CapeConfig, weights: &Weights) -> Result<Vec<(String, HostArray)>> {
    if config.discriminator.as_ref().is_some_and(|discriminator| discriminator.spectral_norm) {
        return Err(Error::Config {
            field: "model.discriminator.spectral_norm".into(),
            message: "must be false for export: the authors' networks have no spectral \
                      normalisation and would use the weights without it"
                .into(),
        });
    }
    let named = weights.iter().map(|(ours, array)| {
        let theirs = official(config, ours).ok_or_else(|| Error::Weight {
            name: ours.clone(),
            message: "no such parameter in a model of this configuration".into(),
        })?;
        let mut shape = array.shape.clone();
        if theirs.ends_with("/bias") && !theirs.ends_with("/dense/bias") {
            while shape.len() < 3 {
                shape.insert(0, 1);
            }
        }
        Ok((format!("{theirs}:0"), HostArray { shape, values: array.values.clone() }))
    });
    named.collect()
}

fn official(config: &CapeConfig, ours: &str) -> Option<String> {
    let parts: Vec<&str> = ours.split('.').collect();
    match parts[..] {
        ["generator", "condition", net, layer, kind] => {
            let (scope, layers) = match net {
                "pose" => ("condition_pose", config.pose_layers),
                "outfit" => ("condition_clo_label", config.outfit_layers),
                _ => return None,
            };
            let number = if layer == "hidden" { 1 } else { layers };
            dense(&format!("{scope}/fc{number}"), kind)
        }
        ["generator", "encoder", "mean", kind] => dense("generator/encoder/fc_mean", kind),
        ["generator", "encoder", "log_variance", kind] => dense("generator/encoder/fc_var", kind),
        ["generator", "encoder", "reduce", "weight"] => {
            Some("generator/encoder/1x1-conv/weights".into())
        }
        ["generator", "encoder", "blocks", index, ref inside @ ..] => {
            let number = index.parse::<usize>().ok()? + 1;
            if config.encoder_residual {
                let scope = format!("generator/encoder/encoder_resblock{number}");
                return residual_encoder(&scope, inside);
            }
            conv_layer(&format!("generator/encoder/encoder_conv{number}"), inside)
        }
        ["generator", "decoder", "input", kind] => dense("generator/decoder/fc1", kind),
        ["generator", "decoder", "expand", "weight"] => {
            Some("generator/decoder/1x1-conv/weights".into())
        }
        ["generator", "decoder", "output", "weight"] => {
            Some("generator/decoder/outputs/weights".into())
        }
        ["generator", "decoder", "output_bias"] => Some("generator/decoder/outputs/bias".into()),
        ["generator", "decoder", "blocks", index, ref inside @ ..] => {
            let number = index.parse::<usize>().ok()? + 1;
            let scope = |name: &str| format!("generator/decoder/{name}{number}");
            match config.decoder {
                DecoderBlock::Residual => residual(&scope("decoder_resblock_cmr"), inside),
                DecoderBlock::Affine => affine(&scope("decoder_resblock_affine"), inside),
                DecoderBlock::Plain => conv_layer(&scope("decoder_conv"), inside),
            }
        }
        ["discriminator", "layers", index, ref inside @ ..] => {
            let number = index.parse::<usize>().ok()? + 1;
            conv_layer(&format!("discriminator/shared/conv{number}"), inside)
        }
        ["discriminator", "output", "weight"] => {
            Some("discriminator/prediction_map/weights".into())
        }
        _ => None,
    }
}

fn dense(scope: &str, kind: &str) -> Option<String> {
    let name = match kind {
        "weight" => "kernel",
        "bias" => "bias",
        _ => return None,
    };
    Some(format!("{scope}/dense/{name}"))
}

fn conv_layer(scope: &str, inside: &[&str]) -> Option<String> {
    let name = match inside {
        ["conv", "weight"] => "weights",
        ["bias"] => "bias",
        _ => return None,
    };
    Some(format!("{scope}/{name}"))
}

fn residual(scope: &str, inside: &[&str]) -> Option<String> {
    let name = match inside {
        ["norm_1", part] => format!("group_norm/{part}"),
        ["norm_2", part] => format!("group_norm_1/{part}"),
        ["norm_3", part] => format!("group_norm_2/{part}"),
        ["linear_1", "weight"] => "graph_linear_1/weights".into(),
        ["conv", "weight"] => "graph_conv/weights".into(),
        ["linear_2", "weight"] => "graph_linear_2/weights".into(),
        ["skip", "weight"] => "graph_linear_input/weights".into(),
        _ => return None,
    };
    Some(format!("{scope}/{name}"))
}

fn affine(scope: &str, inside: &[&str]) -> Option<String> {
    let name = match inside {
        ["conv", "weight"] => "graph_conv/weights",
        ["linear", "weight"] => "affine/weights",
        _ => return None,
    };
    Some(format!("{scope}/{name}"))
}

fn residual_encoder(scope: &str, inside: &[&str]) -> Option<String> {
    let name = match inside {
        ["layer", "conv", "weight"] => "graph_conv_1/weights",
        ["layer", "bias"] => "graph_conv_1/bias",
        ["conv", "weight"] => "graph_conv_2/weights",
        ["bias"] => "graph_conv_2/bias",
        ["skip", "weight"] => "graph_linear_input/weights",
        _ => return None,
    };
    Some(format!("{scope}/{name}"))
}

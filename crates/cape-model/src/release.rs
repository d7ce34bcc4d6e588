//! Weights by the names of the authors' TensorFlow release.
//!
//! | ours | theirs |
//! |---|---|
//! | `generator.condition.pose.{hidden,output}` | `condition_pose/fc{1,2}/dense` |
//! | `generator.condition.outfit.{hidden,output}` | `condition_clo_label/fc{1,2}/dense` |
//! | `generator.encoder.blocks.i` | `generator/encoder/<name>i+1` |
//! | `generator.encoder.reduce` | `generator/encoder/1x1-conv` |
//! | `generator.encoder.{mean,log_variance}` | `generator/encoder/fc_{mean,var}/dense` |
//! | `generator.decoder.input` | `generator/decoder/fc1/dense` |
//! | `generator.decoder.expand` | `generator/decoder/1x1-conv` |
//! | `generator.decoder.blocks.i` | `generator/decoder/<name>i+1` |
//! | `generator.decoder.output`, `.output_bias` | `generator/decoder/outputs/{weights,bias}` |
//! | `discriminator.layers.i` | `discriminator/shared/conv i+1` |
//! | `discriminator.output` | `discriminator/prediction_map` |
//!
//! The blocks' scopes differ in name between the release's architectures (`encoder_conv`,
//! `decoder_resblock_cmr`, `decoder_resblock_affine`, …), so they are recognised by their number;
//! the variables inside by name, and two convolutions of one scope by their shapes, then their
//! order. Shapes agree but for the biases' leading ones.

use std::collections::BTreeMap;

use crate::{
    CapeConfig, DecoderBlock, Error, Result,
    weights::{Array, Weights},
};

/// Each of our parameter names with the release's name for it.
pub type NameMap = BTreeMap<String, String>;

/// Maps our parameter names to those of a set of release variables.
///
/// `shapes` lists the variables' names and shapes in the order they were created in; names may end
/// in `:0`.
///
/// # Errors
/// If a variable the configuration needs is missing, or one is left over; it is named.
pub fn name_map(config: &CapeConfig, shapes: &[(String, Vec<usize>)]) -> Result<NameMap> {
    let mut map = Mapping { shapes, taken: vec![false; shapes.len()], names: NameMap::new() };

    for (ours, theirs, size, layers) in [
        ("pose", "condition_pose", config.pose_embedding, config.pose_layers),
        ("outfit", "condition_clo_label", config.outfit_embedding, config.outfit_layers),
    ] {
        if size == 0 {
            continue;
        }
        if layers == 2 {
            map.dense(&format!("generator.condition.{ours}.hidden"), &format!("{theirs}/fc1"))?;
        }
        map.dense(&format!("generator.condition.{ours}.output"), &format!("{theirs}/fc{layers}"))?;
    }

    let encoder = "generator/encoder";
    let mut input = 3 + if config.encoder_conditions { config.condition_size() } else { 0 };
    for (i, &output) in config.filters.iter().enumerate() {
        let ours = format!("generator.encoder.blocks.{i}");
        let scope = map.block_scope(encoder, i + 1)?;
        if config.encoder_residual {
            map.encoder_residual(&ours, &scope, config.order, input, output)?;
        } else {
            map.conv_layer(&ours, &scope)?;
        }
        input = output;
    }
    map.dense("generator.encoder.mean", &format!("{encoder}/fc_mean"))?;
    map.dense("generator.encoder.log_variance", &format!("{encoder}/fc_var"))?;
    if config.reduce > 0 {
        map.take("generator.encoder.reduce.weight", &format!("{encoder}/1x1-conv/weights"))?;
    }

    let decoder = "generator/decoder";
    map.dense("generator.decoder.input", &format!("{decoder}/fc1"))?;
    if config.reduce > 0 {
        map.take("generator.decoder.expand.weight", &format!("{decoder}/1x1-conv/weights"))?;
    }
    for i in 0..config.filters.len() {
        let ours = format!("generator.decoder.blocks.{i}");
        let scope = map.block_scope(decoder, i + 1)?;
        match config.decoder {
            DecoderBlock::Residual => map.residual(&ours, &scope)?,
            DecoderBlock::Affine => {
                map.take(&format!("{ours}.conv.weight"), &format!("{scope}/graph_conv/weights"))?;
                map.take(&format!("{ours}.linear.weight"), &format!("{scope}/affine/weights"))?;
            }
            DecoderBlock::Plain => map.conv_layer(&ours, &scope)?,
        }
    }
    map.take("generator.decoder.output.weight", &format!("{decoder}/outputs/weights"))?;
    map.take("generator.decoder.output_bias", &format!("{decoder}/outputs/bias"))?;

    if let Some(discriminator) = &config.discriminator {
        for i in 0..discriminator.filters.len() {
            let scope = format!("discriminator/shared/conv{}", i + 1);
            map.conv_layer(&format!("discriminator.layers.{i}"), &scope)?;
        }
        map.take("discriminator.output.weight", "discriminator/prediction_map/weights")?;
    }
    map.finish()
}

/// Reads the weights of a model from release variables.
///
/// # Errors
/// As [`name_map`]; shapes are checked when the weights are applied to a model.
pub fn import(config: &CapeConfig, variables: &[(String, Array)]) -> Result<Weights> {
    let shapes: Vec<_> =
        variables.iter().map(|(name, array)| (name.clone(), array.shape.clone())).collect();
    let by_name: BTreeMap<&str, &Array> =
        variables.iter().map(|(name, array)| (name.as_str(), array)).collect();
    let map = name_map(config, &shapes)?;
    Ok(map
        .into_iter()
        .map(|(ours, theirs)| (ours, without_leading_ones(by_name[theirs.as_str()], &theirs)))
        .collect())
}

/// Biases are stored as `[1, 1, channels]` and `[1, vertices, 3]`.
fn without_leading_ones(array: &Array, name: &str) -> Array {
    let mut shape = array.shape.as_slice();
    if bare(name).ends_with("/bias") {
        while shape.len() > 1 && shape[0] == 1 {
            shape = &shape[1..];
        }
    }
    Array { shape: shape.to_vec(), values: array.values.clone() }
}

fn bare(name: &str) -> &str {
    name.strip_suffix(":0").unwrap_or(name)
}

struct Mapping<'a> {
    shapes: &'a [(String, Vec<usize>)],
    taken: Vec<bool>,
    names: NameMap,
}

impl Mapping<'_> {
    fn claim(&mut self, ours: &str, index: usize) {
        self.taken[index] = true;
        self.names.insert(ours.to_owned(), self.shapes[index].0.clone());
    }

    fn take(&mut self, ours: &str, theirs: &str) -> Result<()> {
        match self.shapes.iter().position(|(name, _)| bare(name) == theirs) {
            Some(index) => {
                self.claim(ours, index);
                Ok(())
            }
            None => Err(missing(theirs)),
        }
    }

    fn dense(&mut self, ours: &str, scope: &str) -> Result<()> {
        self.take(&format!("{ours}.weight"), &format!("{scope}/dense/kernel"))?;
        self.take(&format!("{ours}.bias"), &format!("{scope}/dense/bias"))
    }

    fn conv_layer(&mut self, ours: &str, scope: &str) -> Result<()> {
        self.take(&format!("{ours}.conv.weight"), &format!("{scope}/weights"))?;
        self.take(&format!("{ours}.bias"), &format!("{scope}/bias"))
    }

    fn residual(&mut self, ours: &str, scope: &str) -> Result<()> {
        for (part, norm) in
            [("norm_1", "group_norm"), ("norm_2", "group_norm_1"), ("norm_3", "group_norm_2")]
        {
            self.take(&format!("{ours}.{part}.gamma"), &format!("{scope}/{norm}/gamma"))?;
            self.take(&format!("{ours}.{part}.beta"), &format!("{scope}/{norm}/beta"))?;
        }
        for (part, conv) in
            [("linear_1", "graph_linear_1"), ("conv", "graph_conv"), ("linear_2", "graph_linear_2")]
        {
            self.take(&format!("{ours}.{part}.weight"), &format!("{scope}/{conv}/weights"))?;
        }
        let skip = format!("{scope}/graph_linear_input/weights");
        if self.shapes.iter().any(|(name, _)| bare(name) == skip) {
            self.take(&format!("{ours}.skip.weight"), &skip)?;
        }
        Ok(())
    }

    /// Two convolutions, two biases, and a linear map where the widths differ.
    fn encoder_residual(
        &mut self,
        ours: &str,
        scope: &str,
        order: usize,
        input: usize,
        output: usize,
    ) -> Result<()> {
        self.take_shaped(ours, "bias", scope, "layer.bias", |shape| shape.last() == Some(&output))?;
        self.take_shaped(ours, "bias", scope, "bias", |shape| shape.last() == Some(&output))?;
        if input != output {
            self.take_shaped(ours, "weights", scope, "skip.weight", |s| s == [input, output])?;
        }
        self.take_shaped(ours, "weights", scope, "layer.conv.weight", |shape| {
            shape == [input * order, output]
        })?;
        self.take_shaped(ours, "weights", scope, "conv.weight", |s| s == [output * order, output])
    }

    /// The first free variable of `scope` whose last name starts with `kind` and whose shape fits.
    fn take_shaped(
        &mut self,
        ours: &str,
        kind: &str,
        scope: &str,
        part: &str,
        fits: impl Fn(&[usize]) -> bool,
    ) -> Result<()> {
        let found = self.shapes.iter().enumerate().position(|(index, (name, shape))| {
            let inside = bare(name).strip_prefix(scope).and_then(|rest| rest.strip_prefix('/'));
            let last = inside.and_then(|rest| rest.rsplit('/').next());
            !self.taken[index] && last.is_some_and(|last| last.starts_with(kind)) && fits(shape)
        });
        let index = found.ok_or_else(|| missing(&format!("{scope}/…/{kind}")))?;
        self.claim(&format!("{ours}.{part}"), index);
        Ok(())
    }

    /// The scope of block `number` below `parent`: the one whose name ends in that number and is
    /// not one of the fixed layers.
    fn block_scope(&self, parent: &str, number: usize) -> Result<String> {
        const FIXED: [&str; 5] = ["fc_mean", "fc_var", "fc1", "1x1-conv", "outputs"];
        for (name, _) in self.shapes {
            let Some(scope) = name
                .strip_prefix(parent)
                .and_then(|rest| rest.strip_prefix('/')?.split('/').next())
            else {
                continue;
            };
            let stem = scope.trim_end_matches(|c: char| c.is_ascii_digit());
            if !FIXED.contains(&scope) && scope[stem.len()..].parse() == Ok(number) {
                return Ok(format!("{parent}/{scope}"));
            }
        }
        Err(missing(&format!("{parent}/…{number}")))
    }

    fn finish(self) -> Result<NameMap> {
        match self.taken.iter().position(|taken| !taken) {
            None => Ok(self.names),
            Some(index) => Err(Error::Weight {
                name: self.shapes[index].0.clone(),
                message: "is not a variable of this configuration".into(),
            }),
        }
    }
}

fn missing(name: &str) -> Error {
    Error::Weight { name: name.to_owned(), message: "missing".into() }
}

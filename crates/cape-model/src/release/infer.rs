//! Model configuration from the names and shapes of the release's variables.

use cape_core::Outfit;

use super::{bare, missing};
use crate::{
    CapeConfig, DecoderBlock, DecoderConditions, DiscriminatorConfig, Error, POSE_FEATURE, Result,
    condition::hidden_width,
};

/// Largest number of Chebyshev terms that is tried.
const MOST_TERMS: usize = 16;

/// Infers the architecture from the names and shapes of a model's variables.
///
/// The shapes determine everything but the down-sampling factors; these are the release's defaults
/// for that number of layers (`1,2,1,2,1,2,1,1` for eight, twos in the discriminator), and
/// [`check_vertices`] checks them against a mesh.
///
/// # Errors
/// If a variable is missing or a shape fits no architecture; it is named.
pub fn infer(shapes: &[(String, Vec<usize>)]) -> Result<CapeConfig> {
    if let Some((name, shape)) = shapes.iter().find(|(_, shape)| shape.contains(&0)) {
        return Err(weight(name, format!("shape {shape:?} has no elements")));
    }
    let shapes = Shapes(shapes);
    let encoder = "generator/encoder";
    shapes.check_condition("condition_pose", POSE_FEATURE)?;
    shapes.check_condition("condition_clo_label", Outfit::PAPER.len())?;
    let blocks = shapes.blocks(encoder)?;
    let filters: Vec<usize> = blocks.iter().map(|block| block.output).collect();
    let pose_embedding = shapes.embedding("condition_pose");
    let outfit_embedding = shapes.embedding("condition_clo_label");
    let conditions = pose_embedding + outfit_embedding;
    let (order, input) = order(&blocks, conditions)?;
    let latent = shapes.matrix(&format!("{encoder}/fc_mean/dense/kernel"))?[1];

    let decoder_scope = "generator/decoder";
    let first = shapes.scope(decoder_scope, 1).ok_or_else(|| missing("generator/decoder/…1"))?;
    let decoder = if shapes.get(&format!("{first}/graph_linear_1/weights")).is_some() {
        DecoderBlock::Residual
    } else if shapes.get(&format!("{first}/affine/weights")).is_some() {
        DecoderBlock::Affine
    } else {
        DecoderBlock::Plain
    };
    let code = shapes.matrix(&format!("{decoder_scope}/fc1/dense/kernel"))?[0];
    let output = shapes.matrix(&format!("{decoder_scope}/outputs/weights"))?[0] / order;
    let last = match decoder {
        DecoderBlock::Affine => filters[0] / 2,
        _ => filters[0],
    };
    let config = CapeConfig {
        factors: default_factors(filters.len()),
        order,
        latent,
        reduce: match shapes.get(&format!("{encoder}/1x1-conv/weights")) {
            Some(_) => shapes.matrix(&format!("{encoder}/1x1-conv/weights"))?[1],
            None => 0,
        },
        pose_layers: shapes.layers("condition_pose"),
        pose_embedding,
        outfit_layers: shapes.layers("condition_clo_label"),
        outfit_embedding,
        encoder_conditions: conditions > 0 && input == 3 + conditions,
        encoder_residual: blocks[0].rows.len() > 1,
        decoder,
        decoder_conditions: if output > last {
            DecoderConditions::Everywhere
        } else if code > latent {
            DecoderConditions::Latent
        } else {
            DecoderConditions::None
        },
        discriminator: shapes.discriminator(3 + conditions)?,
        filters,
        ..CapeConfig::paper()
    };
    config.validate()?;
    Ok(config)
}

/// Checks that down-sampling a mesh of `vertices` vertices by the factors of `config` leaves the
/// number of vertices of the fully connected layers.
///
/// # Errors
/// If it does not, or the output layer is of another mesh; the message has both numbers.
pub fn check_vertices(
    config: &CapeConfig,
    shapes: &[(String, Vec<usize>)],
    vertices: usize,
) -> Result<()> {
    let shapes = Shapes(shapes);
    let name = "generator/decoder/outputs/bias";
    let output = shapes.get(name).ok_or_else(|| missing(name))?;
    if output.iter().product::<usize>() != vertices * 3 {
        return Err(weight(
            name,
            format!("shape {output:?}, but the body has {vertices} vertices"),
        ));
    }
    let name = "generator/encoder/fc_mean/dense/kernel";
    let rows = shapes.matrix(name)?[0];
    let channels = match config.reduce {
        0 => config.filters.last().copied().unwrap_or(1),
        reduce => reduce,
    };
    let left = config
        .factors
        .iter()
        .fold(vertices, |vertices, &factor| vertices.div_ceil(factor as usize));
    if left * channels == rows {
        return Ok(());
    }
    Err(weight(
        name,
        format!(
            "{rows} rows are {} vertices of {channels} channels, but the factors {:?} leave {left} of \
             {vertices} vertices: give the down-sampling factors of the model (--factors)",
            rows / channels,
            config.factors
        ),
    ))
}

/// Down-sampling factors of the release for `layers` layers.
fn default_factors(layers: usize) -> Vec<u32> {
    match layers {
        4 => vec![1, 2, 1, 1],
        6 => vec![1, 2, 1, 2, 1, 1],
        8 => vec![1, 2, 1, 2, 1, 2, 1, 1],
        n => vec![1; n],
    }
}

/// Weight matrices of one encoder layer.
struct Block {
    /// Rows of each matrix.
    rows: Vec<usize>,
    /// Columns, equal for all matrices.
    output: usize,
}

impl Block {
    /// Input channels for `order` Chebyshev terms; `None` if the matrices do not fit that order. A
    /// plain layer has one matrix of `order · input` rows; a residual one has another of
    /// `order · output` rows and, if the widths differ, a linear map of `input` rows.
    fn input(&self, order: usize) -> Option<usize> {
        let mut rows = self.rows.clone();
        if rows.len() > 1 {
            let second = rows.iter().position(|&rows| rows == order * self.output)?;
            rows.remove(second);
        }
        rows.sort_unstable();
        match rows[..] {
            [rows] if rows.is_multiple_of(order) => Some(rows / order),
            [linear, rows] if rows == order * linear => Some(linear),
            _ => None,
        }
    }
}

/// Number of Chebyshev terms, and input channels of the first layer (coordinates, with or without
/// conditions), for which the widths of consecutive layers agree.
fn order(blocks: &[Block], conditions: usize) -> Result<(usize, usize)> {
    let fits = |order: usize| {
        let mut inputs = blocks.iter().map(|block| block.input(order));
        let first = inputs.next()?.filter(|&input| input == 3 || input == 3 + conditions)?;
        let outputs = blocks.iter().map(|block| Some(block.output));
        inputs.eq(outputs.take(blocks.len() - 1)).then_some((order, first))
    };
    (1..=MOST_TERMS).find_map(fits).ok_or_else(|| {
        weight(
            "generator/encoder",
            format!("shapes fit no number of Chebyshev terms up to {MOST_TERMS}"),
        )
    })
}

fn weight(name: &str, message: String) -> Error {
    Error::Weight { name: name.into(), message }
}

struct Shapes<'a>(&'a [(String, Vec<usize>)]);

impl<'a> Shapes<'a> {
    fn get(&self, name: &str) -> Option<&'a [usize]> {
        let found = self.0.iter().find(|(found, _)| bare(found) == name);
        found.map(|(_, shape)| shape.as_slice())
    }

    fn matrix(&self, name: &str) -> Result<[usize; 2]> {
        let shape = self.get(name).ok_or_else(|| missing(name))?;
        shape.try_into().map_err(|_| weight(name, format!("shape {shape:?}, expected two axes")))
    }

    /// Fully connected layers of a condition net.
    fn layers(&self, scope: &str) -> usize {
        if self.get(&format!("{scope}/fc2/dense/kernel")).is_some() { 2 } else { 1 }
    }

    /// Output size of a condition net; 0 if there is none.
    fn embedding(&self, scope: &str) -> usize {
        let last = format!("{scope}/fc{}/dense/kernel", self.layers(scope));
        self.get(&last).and_then(|shape| shape.last().copied()).unwrap_or(0)
    }

    /// Checks that the layers of a condition net match its input and each other.
    fn check_condition(&self, scope: &str, input: usize) -> Result<()> {
        let embedding = self.embedding(scope);
        if embedding == 0 {
            return Ok(());
        }
        let mut rows = input;
        let layers = self.layers(scope);
        for layer in 1..=layers {
            let name = format!("{scope}/fc{layer}/dense/kernel");
            let [found, columns] = self.matrix(&name)?;
            let wide = if layer == layers { embedding } else { hidden_width(input, embedding) };
            if [found, columns] != [rows, wide] {
                let message = format!("shape [{found}, {columns}], expected [{rows}, {wide}]");
                return Err(weight(&name, message));
            }
            rows = columns;
        }
        Ok(())
    }

    fn scope(&self, parent: &str, number: usize) -> Option<String> {
        super::block_scope(self.0.iter().map(|(name, _)| name.as_str()), parent, number)
    }

    /// Weight matrices of all layers of the scope `parent`.
    fn blocks(&self, parent: &str) -> Result<Vec<Block>> {
        let mut blocks = Vec::new();
        while let Some(scope) = self.scope(parent, blocks.len() + 1) {
            let inside: Vec<[usize; 2]> = self
                .0
                .iter()
                .filter(|(name, shape)| {
                    let rest = bare(name).strip_prefix(&scope);
                    shape.len() == 2 && rest.is_some_and(|rest| rest.starts_with('/'))
                })
                .map(|(_, shape)| [shape[0], shape[1]])
                .collect();
            let name = format!("{scope}/weights");
            let output = inside.first().ok_or_else(|| missing(&name))?[1];
            if inside.iter().any(|shape| shape[1] != output) {
                return Err(weight(&name, "matrices of one layer differ in width".into()));
            }
            blocks.push(Block { rows: inside.iter().map(|shape| shape[0]).collect(), output });
        }
        if blocks.is_empty() {
            return Err(missing(&format!("{parent}/…1")));
        }
        Ok(blocks)
    }

    fn discriminator(&self, input: usize) -> Result<Option<DiscriminatorConfig>> {
        let name = |layer: usize| format!("discriminator/shared/conv{layer}/weights");
        let mut filters = Vec::new();
        let mut order = 0;
        while self.get(&name(filters.len() + 1)).is_some() {
            let [rows, output] = self.matrix(&name(filters.len() + 1))?;
            let before = filters.last().copied().unwrap_or(input);
            if rows == 0 || !rows.is_multiple_of(before) || (order > 0 && rows / before != order) {
                let message = format!(
                    "{rows} rows for {before} input channels, expected one number of Chebyshev terms \
                     in all layers"
                );
                return Err(weight(&name(filters.len() + 1), message));
            }
            order = rows / before;
            filters.push(output);
        }
        let Some(&last) = filters.last() else { return Ok(None) };
        let output = "discriminator/prediction_map/weights";
        let [rows, one] = self.matrix(output)?;
        if one != 1 || !rows.is_multiple_of(last) {
            let message = format!("shape [{rows}, {one}], expected [terms · {last}, 1]");
            return Err(weight(output, message));
        }
        let output_order = rows / last;
        Ok(Some(DiscriminatorConfig {
            factors: vec![2; filters.len()],
            filters,
            order,
            output_order,
            spectral_norm: false,
        }))
    }
}

//! Construction of an ONNX graph, node by node in the order of computation.

use half::f16;
use ndarray::Array2;

use crate::{
    Error, OnnxModel, Result, WeightPrecision,
    proto::{
        AttributeProto, AttributeType, DataType, Dimension, DimensionProto, GraphProto, IR_VERSION,
        ModelProto, NodeProto, OPSET, OperatorSetIdProto, TensorProto, TensorShapeProto,
        TensorTypeProto, TypeProto, ValueInfoProto,
    },
};

/// Name of the first dimension of all inputs and outputs.
pub(crate) const BATCH: &str = "batch";

/// The numbers of a table in single precision, row-major.
pub(crate) fn single(table: &Array2<f64>) -> Vec<f32> {
    table.iter().map(|&x| x as f32).collect()
}

/// A tensor of the graph.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Value(String);

/// Attribute of an operator.
pub(crate) enum Attribute<'a> {
    Float(f32),
    Int(i64),
    Ints(&'a [i64]),
}

/// A graph under construction.
pub(crate) struct GraphBuilder {
    graph: GraphProto,
    precision: WeightPrecision,
}

impl GraphBuilder {
    pub(crate) fn new(name: &str, precision: WeightPrecision) -> Self {
        let graph = GraphProto { name: name.to_owned(), ..GraphProto::default() };
        Self { graph, precision }
    }

    /// Input `[batch, shape…]` of f32.
    pub(crate) fn input(&mut self, name: &str, shape: &[usize]) -> Value {
        self.graph.input.push(value_info(name, shape));
        Value(name.to_owned())
    }

    /// Names `value` as an output `[batch, shape…]` of f32.
    pub(crate) fn output(&mut self, name: &str, value: &Value, shape: &[usize]) {
        self.graph.output.push(value_info(name, shape));
        self.graph.node.push(NodeProto {
            input: vec![value.0.clone()],
            output: vec![name.to_owned()],
            name: format!("{name}_output"),
            op_type: "Identity".into(),
            attribute: Vec::new(),
        });
    }

    /// Trained numbers in the chosen precision, as f32 in the computation.
    ///
    /// # Errors
    /// If a number is too large for half precision.
    pub(crate) fn weights(&mut self, name: &str, shape: &[usize], values: &[f32]) -> Result<Value> {
        let bytes = match self.precision {
            WeightPrecision::Single => return Ok(self.constants(shape, values)),
            WeightPrecision::Half => halves(name, values)?,
        };
        let half = self.table(shape, DataType::Float16, bytes);
        let single = DataType::Float as i64;
        Ok(self.apply("Cast", &[&half], &[("to", Attribute::Int(single))]))
    }

    /// Numbers in single precision.
    pub(crate) fn constants(&mut self, shape: &[usize], values: &[f32]) -> Value {
        let bytes = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.table(shape, DataType::Float, bytes)
    }

    /// A single number.
    pub(crate) fn scalar(&mut self, value: f32) -> Value {
        self.constants(&[], &[value])
    }

    /// Indices of rows.
    pub(crate) fn indices(&mut self, shape: &[usize], values: &[usize]) -> Value {
        let bytes = values.iter().flat_map(|&x| (x as i32).to_le_bytes()).collect();
        self.table(shape, DataType::Int32, bytes)
    }

    /// Extents or axes.
    fn integers(&mut self, values: &[i64]) -> Value {
        let bytes = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.table(&[values.len()], DataType::Int64, bytes)
    }

    /// A table; one that several layers use is stored once.
    fn table(&mut self, shape: &[usize], data_type: DataType, raw_data: Vec<u8>) -> Value {
        let dims: Vec<i64> = shape.iter().map(|&extent| extent as i64).collect();
        let same = |table: &&TensorProto| {
            table.data_type == data_type as i32 && table.dims == dims && table.raw_data == raw_data
        };
        if let Some(known) = self.graph.initializer.iter().find(same) {
            return Value(known.name.clone());
        }
        let name = format!("table_{}", self.graph.initializer.len());
        let data_type = data_type as i32;
        self.graph.initializer.push(TensorProto { dims, data_type, name: name.clone(), raw_data });
        Value(name)
    }

    /// Applies an operator with one output.
    pub(crate) fn apply(
        &mut self,
        operator: &str,
        inputs: &[&Value],
        attributes: &[(&str, Attribute)],
    ) -> Value {
        let mut outputs = self.apply_many(operator, inputs, attributes, 1);
        outputs.remove(0)
    }

    fn apply_many(
        &mut self,
        operator: &str,
        inputs: &[&Value],
        attributes: &[(&str, Attribute)],
        outputs: usize,
    ) -> Vec<Value> {
        let name = format!("{operator}_{}", self.graph.node.len());
        let outputs: Vec<String> = match outputs {
            1 => vec![name.clone()],
            _ => (0..outputs).map(|i| format!("{name}.{i}")).collect(),
        };
        self.graph.node.push(NodeProto {
            input: inputs.iter().map(|value| value.0.clone()).collect(),
            output: outputs.clone(),
            op_type: operator.to_owned(),
            attribute: attributes.iter().map(|(name, value)| attribute(name, value)).collect(),
            name,
        });
        outputs.into_iter().map(Value).collect()
    }

    pub(crate) fn add(&mut self, a: &Value, b: &Value) -> Value {
        self.apply("Add", &[a, b], &[])
    }

    pub(crate) fn sub(&mut self, a: &Value, b: &Value) -> Value {
        self.apply("Sub", &[a, b], &[])
    }

    pub(crate) fn mul(&mut self, a: &Value, b: &Value) -> Value {
        self.apply("Mul", &[a, b], &[])
    }

    pub(crate) fn div(&mut self, a: &Value, b: &Value) -> Value {
        self.apply("Div", &[a, b], &[])
    }

    pub(crate) fn matmul(&mut self, a: &Value, b: &Value) -> Value {
        self.apply("MatMul", &[a, b], &[])
    }

    pub(crate) fn scale(&mut self, value: &Value, factor: f32) -> Value {
        let factor = self.scalar(factor);
        self.mul(value, &factor)
    }

    /// Rows of `value` along `axis`, with the shape of the indices in place of that axis.
    pub(crate) fn gather(&mut self, value: &Value, indices: &Value, axis: i64) -> Value {
        self.apply("Gather", &[value, indices], &[("axis", Attribute::Int(axis))])
    }

    /// [`gather`](Self::gather) of a list of rows.
    pub(crate) fn select(&mut self, value: &Value, rows: &[usize], axis: i64) -> Value {
        let rows = self.indices(&[rows.len()], rows);
        self.gather(value, &rows, axis)
    }

    pub(crate) fn concat(&mut self, values: &[Value], axis: i64) -> Value {
        if let [value] = values {
            return value.clone();
        }
        let inputs: Vec<&Value> = values.iter().collect();
        self.apply("Concat", &inputs, &[("axis", Attribute::Int(axis))])
    }

    /// Splits `value` along `axis` into `parts` equal parts.
    pub(crate) fn split(&mut self, value: &Value, parts: usize, axis: i64) -> Vec<Value> {
        if parts == 1 {
            return vec![value.clone()];
        }
        let attributes =
            [("axis", Attribute::Int(axis)), ("num_outputs", Attribute::Int(parts as i64))];
        self.apply_many("Split", &[value], &attributes, parts)
    }

    /// `[batch, …]` as `[batch, shape…]`.
    pub(crate) fn reshape(&mut self, value: &Value, shape: &[usize]) -> Value {
        let extents: Vec<i64> =
            std::iter::once(-1).chain(shape.iter().map(|&extent| extent as i64)).collect();
        let extents = self.integers(&extents);
        self.apply("Reshape", &[value, &extents], &[])
    }

    /// Repeats `value` over the extents of `shape`, of which those of 1 keep its own.
    pub(crate) fn expand(&mut self, value: &Value, shape: &[usize]) -> Value {
        let extents: Vec<i64> = shape.iter().map(|&extent| extent as i64).collect();
        let extents = self.integers(&extents);
        self.apply("Expand", &[value, &extents], &[])
    }

    /// Zeros appended along the axis before the last of a tensor of rank 4.
    pub(crate) fn append_row_of_zeros(&mut self, value: &Value) -> Value {
        let pads = self.integers(&[0, 0, 0, 0, 0, 0, 1, 0]);
        self.apply("Pad", &[value, &pads], &[])
    }

    /// Sum or mean along `axis`, which is kept with extent 1 if `keep`.
    pub(crate) fn reduce(&mut self, operator: &str, value: &Value, axis: i64, keep: bool) -> Value {
        let axes = self.integers(&[axis]);
        self.apply(operator, &[value, &axes], &[("keepdims", Attribute::Int(keep.into()))])
    }

    /// The graph as a model.
    pub(crate) fn finish(self, description: &str) -> OnnxModel {
        OnnxModel::new(ModelProto {
            ir_version: IR_VERSION,
            producer_name: "cape".into(),
            producer_version: env!("CARGO_PKG_VERSION").into(),
            doc_string: description.into(),
            graph: Some(self.graph),
            opset_import: vec![OperatorSetIdProto { domain: String::new(), version: OPSET }],
            metadata_props: Vec::new(),
        })
    }
}

fn value_info(name: &str, shape: &[usize]) -> ValueInfoProto {
    let batch = Dimension::Param(BATCH.into());
    let extents = shape.iter().map(|&extent| Dimension::Value(extent as i64));
    let dim = std::iter::once(batch).chain(extents);
    let shape =
        TensorShapeProto { dim: dim.map(|value| DimensionProto { value: Some(value) }).collect() };
    let tensor = TensorTypeProto { elem_type: DataType::Float as i32, shape: Some(shape) };
    ValueInfoProto { name: name.to_owned(), r#type: Some(TypeProto { tensor_type: Some(tensor) }) }
}

fn attribute(name: &str, value: &Attribute) -> AttributeProto {
    let mut attribute = AttributeProto { name: name.to_owned(), ..AttributeProto::default() };
    let kind = match value {
        Attribute::Float(value) => {
            attribute.f = Some(*value);
            AttributeType::Float
        }
        Attribute::Int(value) => {
            attribute.i = Some(*value);
            AttributeType::Int
        }
        Attribute::Ints(values) => {
            attribute.ints = values.to_vec();
            AttributeType::Ints
        }
    };
    attribute.kind = kind as i32;
    attribute
}

fn halves(name: &str, values: &[f32]) -> Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(2 * values.len());
    for &value in values {
        let half = f16::from_f32(value);
        if !half.is_finite() {
            return Err(Error::Overflow { name: name.to_owned(), value });
        }
        bytes.extend(half.to_le_bytes());
    }
    Ok(bytes)
}

use std::collections::HashSet;

use cape_core::{ClothingMask, SmplModel};
use cape_synth::synthetic_body;
use prost::Message;

use crate::{
    OnnxModel, WeightPrecision, export_body, export_decoder, export_encoder,
    proto::{DataType, GraphProto, ModelProto, TensorProto},
};

fn graphs() -> Vec<OnnxModel> {
    let model = cape_weights::pretrained(&burn::tensor::Device::default()).unwrap();
    let mut graphs = Vec::new();
    for precision in [WeightPrecision::Single, WeightPrecision::Half] {
        graphs.push(export_decoder(&model, precision).unwrap());
        graphs.push(export_encoder(&model, precision).unwrap());
        graphs.push(export_body(model.body(), model.mask(), precision).unwrap());
    }
    graphs
}

fn decoded(model: &OnnxModel) -> GraphProto {
    let again = ModelProto::decode(&model.encode()[..]).unwrap();
    assert_eq!(&again, model.proto());
    again.graph.unwrap()
}

fn width(table: &TensorProto) -> usize {
    match DataType::try_from(table.data_type).unwrap() {
        DataType::Float16 => 2,
        DataType::Float | DataType::Int32 => 4,
        DataType::Int64 => 8,
        DataType::Undefined => panic!("{}: no type", table.name),
    }
}

#[test]
fn nodes_use_what_is_defined_before_and_names_are_unique() {
    for model in graphs() {
        let graph = decoded(&model);
        let mut known = HashSet::new();
        let defined = graph.input.iter().map(|input| &input.name);
        for name in defined.chain(graph.initializer.iter().map(|table| &table.name)) {
            assert!(known.insert(name.clone()), "{}: {name} twice", graph.name);
        }
        let mut used = HashSet::new();
        for node in &graph.node {
            for input in &node.input {
                assert!(known.contains(input), "{}: {} before {input}", graph.name, node.name);
                used.insert(input.clone());
            }
            for output in &node.output {
                assert!(known.insert(output.clone()), "{}: {output} twice", graph.name);
            }
        }
        for output in &graph.output {
            assert!(known.contains(&output.name), "{}: {}", graph.name, output.name);
            used.insert(output.name.clone());
        }
        let unused: Vec<_> = known.difference(&used).collect();
        assert!(unused.is_empty(), "{}: unused {unused:?}", graph.name);
    }
}

#[test]
fn tables_have_the_sizes_of_their_extents() {
    for model in graphs() {
        for table in decoded(&model).initializer {
            let numbers: i64 = table.dims.iter().product();
            assert_eq!(table.raw_data.len(), numbers as usize * width(&table), "{}", table.name);
        }
    }
}

#[test]
fn half_precision_halves_the_weights_and_keeps_the_interface() {
    let graphs = graphs();
    let (single, half) = graphs.split_at(3);
    for (single, half) in single.iter().zip(half) {
        assert_eq!((single.inputs(), single.outputs()), (half.inputs(), half.outputs()));
        let share = half.encode().len() as f64 / single.encode().len() as f64;
        assert!((0.5..0.7).contains(&share), "{share}");
    }
}

#[test]
fn bodies_of_other_joints_and_masks_of_other_bodies_are_refused() {
    let body = synthetic_body();
    let mask = ClothingMask::from_indices(10, &[1]).unwrap();
    let refused = export_body(&body, &mask, WeightPrecision::Single).unwrap_err().to_string();
    assert!(refused.contains("10 vertices") && refused.contains("6890"), "{refused}");
    let broken = SmplModel { parents: vec![None; 24], ..body.clone() };
    let mask = ClothingMask::from_weights(&body).unwrap();
    let refused = export_body(&broken, &mask, WeightPrecision::Single).unwrap_err().to_string();
    assert!(refused.contains("kintree_table"), "{refused}");
}

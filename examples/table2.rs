//! Some rows of the paper's table 2 on a packed set.
//!
//! ```sh
//! cargo run --release --example table2 -- data/packed/male data/smpl/SMPL_MALE.pkl table2/male pca,cape
//! ```
//!
//! The arguments are the packed set, the body (`-` for the set's own), the directory of the results,
//! the rows, and optionally the number of epochs. Finished rows are kept; training resumes.

use std::{env, error::Error, ops::ControlFlow, path::Path};

use cape::{
    burn::tensor::Device,
    core::{SmplModel, silent},
    eval::{
        comparison::ComparisonTable,
        table2::{JobEstimate, Table2Options, Table2Row, methods, select_frames},
    },
    infer::RunConfig,
};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [data, body, out, rows, epochs @ ..] = &arguments[..] else {
        return Err("usage: table2 PACKED BODY|- OUT ROW,… [EPOCHS]".into());
    };
    let rows: Vec<Table2Row> = rows.split(',').map(str::parse).collect::<Result<_, _>>()?;
    let mut config = RunConfig::default();
    if let [epochs] = epochs {
        config.train.scale_to_epochs(epochs.parse()?);
    }
    let options = Table2Options {
        data: data.into(),
        out: out.into(),
        body: if body == "-" { None } else { Some(SmplModel::load(body)?) },
        clothing: None,
        config,
        shown: select_frames(Path::new(data))?,
        overwrite: false,
    };
    let device = Device::default();
    let jobs = options.jobs(&rows, 1)?;
    let estimates = options.estimate(&jobs, &device, &mut silent)?;
    let hours = estimates.iter().map(JobEstimate::seconds_left).sum::<f64>() / 3600.0;
    println!("about {hours:.1} hours of training");

    let mut results = Vec::new();
    for job in &jobs {
        let finished = job.result()?;
        let result = if let Some(result) = finished {
            result
        } else {
            let seconds = match job.trainer(&options, &device)? {
                Some(mut trainer) => trainer.run(&mut |_| ControlFlow::Continue(()))?.seconds,
                None => 0.0,
            };
            job.measure(&options, seconds, &device, &mut silent)?
        };
        results.push(result);
        // The table of what is finished.
        let (methods, cape) = methods(&results);
        println!("{}", ComparisonTable::new(&methods, cape).markdown());
    }
    Ok(())
}

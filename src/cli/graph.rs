//! `photocurrent graph`.

use crate::args::{GraphOptions, GraphStyle};
use crate::failure::{Done, Failure};
use crate::file_kind::need_manifest;
use crate::terminal::print;
use photocurrent_core::document::Problem;
use photocurrent_engine::{GraphFormat, Project, graph as draw};

/// Prints the graph of one variant.
pub fn graph(options: &GraphOptions) -> Done {
    need_manifest(&options.manifest, "graph")?;
    let catalogue = photocurrent_nodes::catalogue();
    let project = Project::load(&options.manifest, &options.sets, &catalogue)?;
    let pipeline = match &options.variant {
        None => &project.pipelines[0],
        Some(name) => project.pipeline(name).ok_or_else(|| {
            let names = project.pipelines.iter().map(|pipeline| pipeline.variant.as_str());
            Failure::Problems(vec![
                Problem::new(format!("there is no variant `{name}`")).did_you_mean(name, names),
            ])
        })?,
    };
    let format = match options.format {
        _ if options.json => GraphFormat::Json,
        GraphStyle::Dot => GraphFormat::Dot,
        GraphStyle::Mermaid => GraphFormat::Mermaid,
        GraphStyle::Svg => GraphFormat::Svg,
        GraphStyle::Json => GraphFormat::Json,
    };
    print(&draw(pipeline, &catalogue, format))?;
    Ok(0)
}

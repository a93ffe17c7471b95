//! What a node is: typed for its author, erased for the engine.

use crate::context::Context;
use crate::error::NodeError;
use crate::ports::{Arity, PortMetas, PortSpec, PortValues, Ports};
use crate::value::Meta;
use schemars::JsonSchema;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::PathBuf;

/// How far an output element reaches into the inputs: decides whether a node may be run band by band.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grain {
    /// A pixel needs only itself.
    Pixel,
    /// A row needs this many rows above and below.
    Row {
        /// Rows above and below.
        halo: u32,
    },
    /// A frame needs only itself, but all of it.
    Frame,
    /// Anything may need everything.
    Whole,
}

/// What a node says about itself.
#[derive(Clone, Copy, Debug)]
pub struct Decl {
    /// `family/name`.
    pub kind: &'static str,
    /// One sentence for lists.
    pub about: &'static str,
    /// Rises when output changes on purpose.
    pub revision: u32,
    /// How far an output element reaches; [`Node::grain`] may say otherwise of some inputs.
    pub grain: Grain,
    /// Does it use the seed?
    pub draws: bool,
    /// Does it write files for the user?
    pub exports: bool,
    /// Papers and equations behind it.
    pub sources: &'static [&'static str],
    /// A manifest fragment that uses it (`[nodes.x]` tables): checked by the conformance test, shown in the
    /// manual.
    pub example: &'static str,
}

/// An outside file whose content decides the output.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileRef {
    /// The parameter that names it.
    pub param: String,
    /// Where it is.
    pub path: PathBuf,
}

/// Memory that a node takes besides its inputs and outputs, bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Working {
    /// Of each thread, however few rows it does at once.
    pub per_thread: u64,
    /// With all rows at once; some rows take their part.
    pub banded: u64,
}

/// One kind of node.
pub trait Node: Sized + Send + Sync + 'static {
    /// What it says about itself.
    const DECL: Decl;
    /// Is what it gives at some instant decided by what its inputs have near that instant? Then a long
    /// recording may be cut into blocks of time that overlap (`pipeline.blocks`), the node run for each, and
    /// its events, frames or tracks joined.
    const LOCAL_IN_TIME: bool = false;
    /// Its parameters: doc comments are the manual, ranges and units the checks.
    type Params: DeserializeOwned + Serialize + JsonSchema + Default;
    /// Its input sockets.
    type In: Ports;
    /// Its output sockets.
    type Out: Ports;

    /// From parameters; refuses combinations that cannot work.
    ///
    /// # Errors
    /// With the reason, naming the parameter.
    fn build(params: Self::Params) -> Result<Self, NodeError>;

    /// What the outputs will look like, in the order of `Out`, before any data exist.
    ///
    /// # Errors
    /// When these inputs cannot work, with the reason.
    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError>;

    /// How far an output element reaches with these inputs: asked after [`Node::plan`] accepted them. For a
    /// node that couples pixels only when its inputs say so; all others leave it at what they declare.
    fn grain(&self, _inputs: &PortMetas) -> Grain {
        Self::DECL.grain
    }

    /// Names of the scores that it may give with these parameters, such as `psnr_db`, with their unit at the
    /// end: a manifest may set bounds on them. None for a node that scores nothing; a score that is not named
    /// here is the node's failure.
    fn metrics(_params: &Self::Params) -> Vec<String> {
        Vec::new()
    }

    /// About how much memory it takes besides these inputs and its outputs, where that counts: asked after
    /// [`Node::plan`] accepted them.
    fn working(&self, _inputs: &PortMetas) -> Working {
        Working::default()
    }

    /// Does the work for `cx.rows()`.
    ///
    /// # Errors
    /// When input data fail a check, a file cannot be read or written, or the user interrupts.
    fn run(&self, input: Self::In, cx: &Context) -> Result<Self::Out, NodeError>;

    /// Outside files whose content decides the output.
    fn files(&self) -> Vec<FileRef> {
        Vec::new()
    }

    /// What does its work where that is not the processor and decides bits of the output: a card with its
    /// driver and version. It becomes the parameter `machine` of the node's key.
    fn machine(&self) -> Option<String> {
        None
    }
}

/// A node with its types erased.
pub trait AnyNode: Send + Sync {
    /// [`Node::plan`].
    ///
    /// # Errors
    /// As [`Node::plan`].
    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError>;
    /// [`Node::grain`].
    fn grain(&self, inputs: &PortMetas) -> Grain;
    /// [`Node::working`].
    fn working(&self, inputs: &PortMetas) -> Working;
    /// [`Node::run`].
    ///
    /// # Errors
    /// As [`Node::run`].
    fn run(&self, input: PortValues, cx: &Context) -> Result<PortValues, NodeError>;
    /// [`Node::files`].
    fn files(&self) -> Vec<FileRef>;
}

struct Erased<N>(N);

impl<N: Node> AnyNode for Erased<N> {
    fn plan(&self, inputs: &PortMetas) -> Result<Vec<Meta>, NodeError> {
        self.0.plan(inputs)
    }
    fn grain(&self, inputs: &PortMetas) -> Grain {
        self.0.grain(inputs)
    }
    fn working(&self, inputs: &PortMetas) -> Working {
        self.0.working(inputs)
    }
    fn run(&self, input: PortValues, cx: &Context) -> Result<PortValues, NodeError> {
        Ok(self.0.run(N::In::take(input), cx)?.give())
    }
    fn files(&self) -> Vec<FileRef> {
        self.0.files()
    }
}

/// A node ready to plan and run, with its parameters as they count: defaults filled in.
pub struct Built {
    /// The node.
    pub node: Box<dyn AnyNode>,
    /// All parameters, defaults filled in, as JSON.
    pub params: serde_json::Value,
    /// [`Node::metrics`] with them.
    pub metrics: Vec<String>,
}

/// A node kind with its types erased: a line of the catalogue.
pub struct Kind {
    /// What it says about itself.
    pub decl: Decl,
    /// Input sockets.
    pub inputs: Vec<PortSpec>,
    /// Output sockets.
    pub outputs: Vec<PortSpec>,
    /// [`Node::LOCAL_IN_TIME`].
    pub local_in_time: bool,
    /// JSON Schema of the parameters.
    pub schema: serde_json::Value,
    /// [`Node::metrics`] with its defaults.
    pub metrics: Vec<String>,
    build: fn(serde_json::Value) -> Result<Built, NodeError>,
}

impl Kind {
    /// Of a node type.
    pub fn of<N: Node>() -> Kind {
        Kind {
            decl: N::DECL,
            inputs: N::In::specs(),
            outputs: N::Out::specs(),
            local_in_time: N::LOCAL_IN_TIME,
            schema: schemars::schema_for!(N::Params).to_value(),
            metrics: N::metrics(&N::Params::default()),
            build: |params| {
                let params: N::Params =
                    serde_json::from_value(params).map_err(|error| NodeError::usage(error.to_string()))?;
                let mut canonical =
                    serde_json::to_value(&params).map_err(|error| NodeError::usage(error.to_string()))?;
                let metrics = N::metrics(&params);
                let node = N::build(params)?;
                if let (Some(machine), Some(params)) = (node.machine(), canonical.as_object_mut()) {
                    params.insert("machine".into(), machine.into());
                }
                Ok(Built { node: Box::new(Erased(node)), params: canonical, metrics })
            },
        }
    }

    /// Builds a node from parameters that were checked against [`Kind::schema`].
    ///
    /// # Errors
    /// When the parameters do not go together.
    pub fn build(&self, params: serde_json::Value) -> Result<Built, NodeError> {
        (self.build)(params)
    }

    /// An output socket by name.
    pub fn output(&self, name: &str) -> Option<&PortSpec> {
        self.outputs.iter().find(|port| port.name == name)
    }

    /// An input socket by name.
    pub fn input(&self, name: &str) -> Option<&PortSpec> {
        self.inputs.iter().find(|port| port.name == name)
    }

    /// The output that the node's name alone stands for: its only one, or its only one that is always there.
    pub fn main_output(&self) -> Option<&PortSpec> {
        let mut sure = self.outputs.iter().filter(|port| port.arity != Arity::Optional);
        match (self.outputs.as_slice(), sure.next(), sure.next()) {
            ([only], _, _) | (_, Some(only), None) => Some(only),
            _ => None,
        }
    }
}

/// All node kinds, in reading order.
pub struct Catalogue {
    kinds: Vec<Kind>,
    retired: &'static [(&'static str, &'static str)],
}

impl Catalogue {
    /// From a list; two kinds of one name are a mistake of the list.
    ///
    /// # Panics
    /// When a name appears twice.
    pub fn new(kinds: Vec<Kind>) -> Catalogue {
        for (i, kind) in kinds.iter().enumerate() {
            assert!(
                kinds[..i].iter().all(|other| other.decl.kind != kind.decl.kind),
                "node kind {} is listed twice",
                kind.decl.kind
            );
        }
        Catalogue { kinds, retired: &[] }
    }

    /// With names that kinds had before, each with what to write in its place.
    #[must_use]
    pub fn with_retired(self, retired: &'static [(&'static str, &'static str)]) -> Catalogue {
        Catalogue { retired, ..self }
    }

    /// What to write in place of a name that kinds had before; `None` for every other.
    pub fn in_place_of(&self, kind: &str) -> Option<&'static str> {
        self.retired.iter().find(|(name, _)| *name == kind).map(|(_, instead)| *instead)
    }

    /// In reading order.
    pub fn kinds(&self) -> &[Kind] {
        &self.kinds
    }

    /// By name.
    pub fn get(&self, kind: &str) -> Option<&Kind> {
        self.kinds.iter().find(|k| k.decl.kind == kind)
    }
}

/// Writes parameters for a key: object keys sorted, floats by their bits (`-0.0` folded), paths left out
/// (their content counts, not their place).
pub fn canonical_params(params: &serde_json::Value, schema: &serde_json::Value) -> String {
    let mut params = params.clone();
    crate::schema::strip_paths(&mut params, schema);
    let mut text = String::new();
    write_canonical(&params, &mut text);
    text
}

fn write_canonical(value: &serde_json::Value, text: &mut String) {
    use serde_json::Value;
    match value {
        Value::Object(map) => {
            let mut entries: Vec<_> = map.iter().collect();
            entries.sort_by_key(|(key, _)| *key);
            text.push('{');
            for (key, value) in entries {
                text.push_str(&format!("{key:?}:"));
                write_canonical(value, text);
                text.push(',');
            }
            text.push('}');
        }
        Value::Array(items) => {
            text.push('[');
            for item in items {
                write_canonical(item, text);
                text.push(',');
            }
            text.push(']');
        }
        Value::Number(number) if number.is_f64() => {
            let value = number.as_f64().unwrap_or(0.0);
            text.push_str(&format!("f{:016x}", if value == 0.0 { 0 } else { value.to_bits() }));
        }
        other => text.push_str(&other.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn canonical_parameters_do_not_depend_on_key_order_or_on_the_sign_of_zero() {
        let schema = json!({});
        assert_eq!(
            canonical_params(&json!({"a": 1.5, "b": [0.0, "x"]}), &schema),
            canonical_params(&json!({"b": [-0.0, "x"], "a": 1.5}), &schema)
        );
        assert_ne!(
            canonical_params(&json!({"a": 1.5}), &schema),
            canonical_params(&json!({"a": 1.5000000000000002}), &schema)
        );
    }
}

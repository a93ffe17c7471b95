//! Ports: the sockets of a node. Typed inside the node, erased outside.
//!
//! A node declares its sockets as a struct with the [`ports!`](crate::ports!) macro; a field's Rust type says
//! the data type and how many values may be plugged in: `EventStream` exactly one, `Option<FrameSequence>`
//! none or one, `Vec<Arc<Table>>` one or more.

use crate::data_type::DataType;
use crate::diagnosis::{Diagnosis, DiagnosisMeta};
use crate::error::NodeError;
use crate::events::{EventStream, EventsMeta};
use crate::frames::{FrameSequence, FramesMeta, Truth};
use crate::light::{Light, LightMeta};
use crate::map::{MapMeta, MapSet};
use crate::sensor::Sensor;
use crate::table::Table;
use crate::tracks::{TrackSet, TracksMeta};
use crate::value::{Meta, Value};
use std::collections::BTreeMap;
use std::sync::Arc;

/// How many values a port takes or gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arity {
    /// Exactly one.
    One,
    /// None or one. An optional output may turn out absent.
    Optional,
    /// One or more, written as a list in the manifest.
    Many,
}

/// A port as the engine sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PortSpec {
    /// Its name in manifests.
    pub name: &'static str,
    /// What it takes or gives.
    pub data_type: DataType,
    /// How many.
    pub arity: Arity,
    /// One line for the manual.
    pub about: &'static str,
}

/// The values at a node's ports, by port name.
pub type PortValues = BTreeMap<&'static str, Vec<Value>>;

/// A Rust type that can stand at a port.
pub trait Port: Sized {
    /// The data type.
    const DATA_TYPE: DataType;
    /// How many.
    const ARITY: Arity;
    /// From the values plugged in. The engine has checked type and number; anything else is a broken
    /// invariant.
    fn take(values: Vec<Value>) -> Self;
    /// Back to values.
    fn give(self) -> Vec<Value>;
}

macro_rules! port {
    ($type:ty, $variant:ident) => {
        impl Port for $type {
            const DATA_TYPE: DataType = DataType::$variant;
            const ARITY: Arity = Arity::One;
            fn take(values: Vec<Value>) -> Self {
                match values.into_iter().next() {
                    Some(Value::$variant(value)) => value,
                    other => panic!("the plan put {other:?} on a port for {}", DataType::$variant),
                }
            }
            fn give(self) -> Vec<Value> {
                vec![Value::$variant(self)]
            }
        }
    };
}

port!(EventStream, Events);
port!(FrameSequence, Frames);
port!(Truth, Truth);
port!(TrackSet, Tracks);
port!(Light, Light);
port!(Arc<Sensor>, Sensor);
port!(MapSet, Map);
port!(Arc<Table>, Table);
port!(Arc<Diagnosis>, Diagnosis);

impl<P: Port> Port for Option<P> {
    const DATA_TYPE: DataType = P::DATA_TYPE;
    const ARITY: Arity = Arity::Optional;
    fn take(values: Vec<Value>) -> Self {
        (!values.is_empty()).then(|| P::take(values))
    }
    fn give(self) -> Vec<Value> {
        self.map(P::give).unwrap_or_default()
    }
}

impl<P: Port> Port for Vec<P> {
    const DATA_TYPE: DataType = P::DATA_TYPE;
    const ARITY: Arity = Arity::Many;
    fn take(values: Vec<Value>) -> Self {
        values.into_iter().map(|value| P::take(vec![value])).collect()
    }
    fn give(self) -> Vec<Value> {
        self.into_iter().flat_map(P::give).collect()
    }
}

/// All sockets of one side of a node. Made by [`ports!`](crate::ports!).
pub trait Ports: Sized {
    /// The sockets in declared order.
    fn specs() -> Vec<PortSpec>;
    /// From the values plugged in.
    fn take(values: PortValues) -> Self;
    /// Back to values; absent optional ones have an empty list.
    fn give(self) -> PortValues;
}

/// Declares a struct of ports.
///
/// ```
/// photocurrent_core::ports! {
///     /// What the node needs.
///     pub struct In {
///         /// The events.
///         events: photocurrent_core::EventStream,
///         /// Frames, when there are any.
///         frames: Option<photocurrent_core::FrameSequence>,
///     }
/// }
/// use photocurrent_core::Ports;
/// assert_eq!(In::specs()[1].name, "frames");
/// assert_eq!(In::specs()[0].about, "The events.");
/// ```
#[macro_export]
macro_rules! ports {
    ($(#[$doc:meta])* $vis:vis struct $name:ident {
        $($(#[doc = $about:literal])+ $port:ident: $type:ty),* $(,)?
    }) => {
        $(#[$doc])*
        $vis struct $name {
            $($(#[doc = $about])+ pub $port: $type,)*
        }

        impl $crate::ports::Ports for $name {
            fn specs() -> Vec<$crate::ports::PortSpec> {
                vec![$($crate::ports::PortSpec {
                    name: stringify!($port),
                    data_type: <$type as $crate::ports::Port>::DATA_TYPE,
                    arity: <$type as $crate::ports::Port>::ARITY,
                    // Every line of a doc comment begins with a space.
                    about: concat!($($about),+).trim_ascii(),
                }),*]
            }
            #[allow(unused_mut, unused_variables)]
            fn take(mut values: $crate::ports::PortValues) -> Self {
                $name {
                    $($port: <$type as $crate::ports::Port>::take(
                        values.remove(stringify!($port)).unwrap_or_default(),
                    ),)*
                }
            }
            fn give(self) -> $crate::ports::PortValues {
                $crate::ports::PortValues::from([
                    $((stringify!($port), <$type as $crate::ports::Port>::give(self.$port))),*
                ])
            }
        }
    };
}

/// What is known about the values at a node's input ports while planning.
#[derive(Clone, Debug, Default)]
pub struct PortMetas(BTreeMap<String, Vec<Meta>>);

macro_rules! meta_of {
    ($(#[$doc:meta])* $one:ident, $variant:ident, $meta:ty) => {
        $(#[$doc])*
        ///
        /// # Errors
        /// When nothing of this type is there; the engine has checked that for required ports, so this is for
        /// optional ones.
        pub fn $one(&self, port: &str) -> Result<&Arc<$meta>, NodeError> {
            let first = self.0.get(port).and_then(|metas| metas.first());
            first
                .and_then(|meta| match meta {
                    Meta::$variant(meta) => Some(meta),
                    _ => None,
                })
                .ok_or_else(|| NodeError::usage(format!("nothing is connected to `{port}`")))
        }
    };
}

impl PortMetas {
    /// From port names and metas in the order of the manifest.
    pub fn new(metas: BTreeMap<String, Vec<Meta>>) -> PortMetas {
        PortMetas(metas)
    }

    /// Everything at a port.
    pub fn all(&self, port: &str) -> &[Meta] {
        self.0.get(port).map_or(&[], Vec::as_slice)
    }

    /// Is anything connected to a port?
    pub fn has(&self, port: &str) -> bool {
        !self.all(port).is_empty()
    }

    /// Every meta with its port.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Meta)> {
        self.0.iter().flat_map(|(port, metas)| metas.iter().map(move |meta| (port.as_str(), meta)))
    }

    meta_of!(
        /// The events at a port.
        events, Events, EventsMeta);
    meta_of!(
        /// The frames at a port.
        frames, Frames, FramesMeta);
    meta_of!(
        /// The true frames at a port.
        truth, Truth, FramesMeta);
    meta_of!(
        /// The tracks at a port.
        tracks, Tracks, TracksMeta);
    meta_of!(
        /// The map at a port.
        map, Map, MapMeta);
    meta_of!(
        /// The light at a port.
        light, Light, LightMeta);
    meta_of!(
        /// The sensor description at a port.
        sensor, Sensor, Sensor);
    meta_of!(
        /// The document of a diagnosis at a port.
        diagnosis, Diagnosis, DiagnosisMeta);
}

//! The card: which one, what it must have, and what becomes of its errors.

use crate::template::{BINDINGS, LARGEST_BINDING};
use photocurrent_core::NodeError;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Names the card to take: a part of its name, whatever its case. Without it, the first of the driver's list,
/// but cards before programs that stand in for one.
pub const ADAPTER_VARIABLE: &str = "PHOTOCURRENT_ADAPTER";

/// An opened card.
pub(crate) struct Opened {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    pub(crate) has_double: bool,
    /// What names it in keys of caches.
    pub(crate) name: String,
    trouble: Arc<Mutex<Option<String>>>,
}

/// The card that the environment names.
pub(crate) fn wanted() -> Option<String> {
    std::env::var(ADAPTER_VARIABLE).ok().filter(|name| !name.is_empty())
}

/// What the card is, in words: name, driver and its version. Its bits depend on all of them.
fn described(info: &wgpu::AdapterInfo) -> String {
    let driver = [info.driver.as_str(), info.driver_info.as_str()].join(" ");
    format!("{}, {}, {:?}", info.name, driver.trim(), info.backend)
}

/// All cards of this machine, software last.
pub(crate) fn adapters() -> Vec<wgpu::Adapter> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN;
    let instance = wgpu::Instance::new(descriptor);
    let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::VULKAN));
    // Software last; otherwise as the driver lists them.
    adapters.sort_by_key(|adapter| adapter.get_info().device_type == wgpu::DeviceType::Cpu);
    adapters
}

/// The card that `wanted`, a part of a name, chooses; the first where nothing is wanted.
///
/// # Errors
/// When there is no card, or none of that name.
pub(crate) fn chosen(wanted: Option<&str>) -> Result<wgpu::Adapter, NodeError> {
    let all = adapters();
    let names: Vec<String> = all.iter().map(|adapter| described(&adapter.get_info())).collect();
    let fits = |name: &String| wanted.is_none_or(|part| name.to_lowercase().contains(&part.to_lowercase()));
    if let Some((_, adapter)) = names.iter().zip(all).find(|(name, _)| fits(name)) {
        return Ok(adapter);
    }
    let error = match wanted {
        Some(part) if !names.is_empty() => NodeError::usage(format!(
            "{ADAPTER_VARIABLE} is {part:?}, and no graphics card here is called that"
        ))
        .hint(format!("name a part of one of these, or unset {ADAPTER_VARIABLE}")),
        _ => NodeError::usage(
            "`backend = \"gpu\"` needs a graphics card with a Vulkan driver, and none is here",
        )
        .hint(
            "install the card's driver with its Vulkan part (on Debian, mesa-vulkan-drivers has one that \
                 runs on the processor as well), or leave `backend` at \"cpu\"",
        ),
    };
    Err(names.into_iter().fold(error, |error, name| error.note(format!("there is {name}"))).param("backend"))
}

/// What names the card that would be taken.
///
/// # Errors
/// As [`chosen`].
pub(crate) fn name(wanted: Option<&str>) -> Result<String, NodeError> {
    Ok(described(&chosen(wanted)?.get_info()))
}

impl Opened {
    /// Opens a card.
    ///
    /// # Errors
    /// When it lacks what the shaders need, or its driver refuses.
    pub(crate) fn open(adapter: &wgpu::Adapter, with_double: bool) -> Result<Opened, NodeError> {
        let name = described(&adapter.get_info());
        let has = adapter.limits();
        for (what, has, needs) in [
            (
                "storage buffers of a shader",
                u64::from(has.max_storage_buffers_per_shader_stage),
                u64::from(BINDINGS),
            ),
            ("bytes of a binding", has.max_storage_buffer_binding_size, LARGEST_BINDING),
            ("bytes of a buffer", has.max_buffer_size, LARGEST_BINDING),
        ] {
            if has < needs {
                return Err(NodeError::failed(format!("{name} has {has} {what}, and {needs} are needed"))
                    .hint(format!(
                        "choose another card with {ADAPTER_VARIABLE}, or leave `backend` at \"cpu\""
                    ))
                    .param("backend"));
            }
        }
        let limits = wgpu::Limits {
            max_storage_buffers_per_shader_stage: BINDINGS,
            max_storage_buffer_binding_size: LARGEST_BINDING,
            max_buffer_size: has.max_buffer_size,
            ..wgpu::Limits::downlevel_defaults()
        };
        let has_double = with_double && adapter.features().contains(wgpu::Features::SHADER_F64);
        let features = if has_double { wgpu::Features::SHADER_F64 } else { wgpu::Features::empty() };
        let request = adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("photocurrent"),
            required_features: features,
            required_limits: limits,
            ..Default::default()
        });
        let (device, queue) = pollster::block_on(request).map_err(|error| {
            NodeError::failed(format!("{name} cannot be opened: {error}")).param("backend")
        })?;
        let trouble: Arc<Mutex<Option<String>>> = Arc::default();
        let (of_errors, of_loss) = (Arc::clone(&trouble), Arc::clone(&trouble));
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| keep(&of_errors, error.to_string())));
        device.set_device_lost_callback(move |reason, message| {
            // Giving a card back ends it too.
            if reason != wgpu::DeviceLostReason::Destroyed {
                keep(&of_loss, format!("the card was lost: {message}"));
            }
        });
        Ok(Opened { device, queue, has_double, name, trouble })
    }

    /// What went wrong since the card was opened, as an error: nothing is computed with it any more.
    ///
    /// # Errors
    /// When something did.
    pub(crate) fn check(&self) -> Result<(), NodeError> {
        match held(&self.trouble).as_deref() {
            Some(trouble) => Err(self.failed(trouble)),
            None => Ok(()),
        }
    }

    /// Remembers that something went wrong: what is in the card's memory is not known any more.
    pub(crate) fn spoil(&self, trouble: &str) {
        keep(&self.trouble, trouble.into());
    }

    /// An error of this card.
    pub(crate) fn failed(&self, trouble: &str) -> NodeError {
        let own = trouble.strip_prefix(&format!("{}: ", self.name)).unwrap_or(trouble);
        NodeError::failed(format!("{}: {}", self.name, own.trim_end()))
            .hint(
                "close what else uses the card, or leave `backend` at \"cpu\"; what was finished before is \
                 kept",
            )
            .param("backend")
    }
}

fn held(trouble: &Mutex<Option<String>>) -> MutexGuard<'_, Option<String>> {
    trouble.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The first counts: others follow from it.
fn keep(trouble: &Mutex<Option<String>>, text: String) {
    held(trouble).get_or_insert(text);
}

//! Selection of the depth channel in OpenEXR files.
//!
//! A channel is depth by its name (`Z`, `depth`, …), or by that of its layer or part (`depth.R`, `ViewLayer.Depth.Z`,
//! `Z` of the part `depth`). A `Z` is not depth if it is a component of a vector (with `X` or `W`), or in the layer
//! `Mist`. If no name matches, depth is the file's only channel (unless that is alpha), its luminance `Y`, or its red
//! channel if red, green and blue are equal. Several matching names are an error.

use super::Map;
use crate::openexr::{File, Part};

/// Names of depth, in lower case.
const DEPTH: [&str; 8] = ["depth", "z", "zdepth", "z_depth", "inverse_depth", "inv_depth", "disparity", "linear_depth"];
/// Maximum number of names that a message lists.
const LISTED: usize = 12;

/// A channel at full resolution.
struct Channel<'a> {
    part: Part<'a>,
    /// Its name in the part.
    name: String,
}

impl Channel<'_> {
    /// Returns the layer in front of the name, else the part's name; and the name itself, in lower case.
    fn layer_and_name(&self) -> (String, String) {
        let (layer, name) = match self.name.rsplit_once('.') {
            Some((layer, name)) => (layer.rsplit('.').next().unwrap_or(layer).to_owned(), name),
            None => (self.part.name(), self.name.as_str()),
        };
        (layer.to_ascii_lowercase(), name.to_ascii_lowercase())
    }

    /// Returns the layer prefix of the full name, with its trailing dot; empty if there is none.
    fn prefix(&self) -> &str {
        self.name.rfind('.').map_or("", |point| &self.name[..=point])
    }
}

/// Reads the depth channel. Samples outside of the data window count as not measured.
pub(super) fn read(bytes: &[u8]) -> Result<Map, String> {
    let file = File::open(bytes).map_err(|e| e.to_string())?;
    let mut channels = Vec::new();
    for part in file.parts().filter(|part| !part.is_deep()) {
        channels.extend(part.channels().filter(|(_, full)| *full).map(|(name, _)| Channel { part, name }));
    }
    let samples = |chosen: &[&Channel<'_>]| {
        let names: Vec<&str> = chosen.iter().map(|channel| channel.name.as_str()).collect();
        file.read(chosen[0].part, &names, f32::NAN).map_err(|e| e.to_string())
    };
    let of = |channel: &Channel<'_>| {
        let window = channel.part.display();
        let values = samples(&[channel])?.swap_remove(0);
        Ok(Map { width: window.width, height: window.height, values })
    };
    let named: Vec<&Channel<'_>> = channels.iter().filter(|channel| is_depth(channel, &channels)).collect();
    match named[..] {
        [] => {}
        [one] => return of(one),
        ref several => {
            return Err(format!("expected one EXR channel of depth, found {}", listed(several.iter().copied())));
        }
    }
    if let [only] = &channels[..]
        && !matches!(only.layer_and_name().1.as_str(), "a" | "alpha")
    {
        return of(only);
    }
    let first = |name: &str| channels.iter().find(|channel| channel.name == name);
    let colours = [first("R"), first("G"), first("B")];
    match (first("Y"), colours) {
        (Some(grey), [None, None, None]) => of(grey),
        (None, [Some(r), Some(g), Some(b)]) if channels.iter().all(|c| c.prefix().is_empty()) => {
            let planes = samples(&[r, g, b])?;
            let same = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits());
            if same(&planes[0], &planes[1]) && same(&planes[0], &planes[2]) {
                return of(r);
            }
            Err("expected an EXR channel of depth (Z, depth) or grey, found R, G and B that differ".to_owned())
        }
        _ => Err(format!("expected an EXR channel of depth (Z, depth), found {}", listed(channels.iter()))),
    }
}

/// Returns true if a channel is depth by its name.
fn is_depth(channel: &Channel<'_>, all: &[Channel<'_>]) -> bool {
    let (layer, name) = channel.layer_and_name();
    let beside = |names: [&str; 2]| {
        all.iter().any(|other| {
            let same = other.part.name() == channel.part.name() && other.prefix() == channel.prefix();
            let (_, other) = other.layer_and_name();
            same && names.contains(&other.as_str())
        })
    };
    match name.as_str() {
        "z" => layer != "mist" && (DEPTH.contains(&layer.as_str()) || !beside(["x", "w"])),
        // Grey that is written as a colour, or alone.
        "r" | "y" | "v" => DEPTH.contains(&layer.as_str()) && !beside(["z", "depth"]),
        name => DEPTH.contains(&name),
    }
}

fn listed<'c>(channels: impl ExactSizeIterator<Item = &'c Channel<'c>>) -> String {
    let more = channels.len().saturating_sub(LISTED);
    let names: Vec<&str> = channels.take(LISTED).map(|channel| channel.name.as_str()).collect();
    let text = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
    if more > 0 { format!("{text} and {more} more") } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::openexr::{NamedLayer, Planes, write_layers};

    /// Reads the depth of a file of parts, each with channels of one value.
    fn depth(parts: &[(&str, &[(&str, f32)])]) -> Result<f32, String> {
        let channels = |channels: &[(&str, f32)]| {
            channels.iter().map(|(name, value)| (name.to_string(), vec![*value; 2])).collect::<Vec<_>>()
        };
        let layers: Vec<NamedLayer<'_>> = parts
            .iter()
            .map(|(name, of)| NamedLayer {
                name,
                planes: Planes { width: 2, height: 1, channels: channels(of) },
                comment: "",
                colour_space: None,
            })
            .collect();
        let mut bytes = Vec::new();
        write_layers(&layers, &mut bytes).expect("memory");
        read(&bytes).map(|map| map.values[1])
    }

    #[test]
    fn depth_is_chosen_by_its_name() {
        let rgb = [("B", 0.1), ("G", 0.2), ("R", 0.3)];
        assert_eq!(depth(&[("rgba", &rgb), ("depth", &[("Z", 5.0)])]), Ok(5.0));
        assert_eq!(depth(&[("rgba", &rgb), ("depth", &[("Y", 5.0)])]), Ok(5.0));
        assert_eq!(depth(&[("a", &[("B", 0.1), ("G", 0.2), ("R", 0.3), ("Z", 5.0)])]), Ok(5.0));
        assert_eq!(depth(&[("a", &[("Y", 1.0), ("Z", 5.0)])]), Ok(5.0));
        let blender = [
            ("ViewLayer.Combined.R", 0.1),
            ("ViewLayer.Depth.Z", 5.0),
            ("ViewLayer.Mist.Z", 0.4),
            ("ViewLayer.Normal.X", 0.5),
            ("ViewLayer.Normal.Y", 0.6),
            ("ViewLayer.Normal.Z", 0.7),
        ];
        assert_eq!(depth(&[("a", &blender)]), Ok(5.0));
        assert_eq!(depth(&[("a", &[("depth.B", 5.0), ("depth.G", 5.0), ("depth.R", 5.0)])]), Ok(5.0));
        assert_eq!(depth(&[("a", &[("anything", 5.0)])]), Ok(5.0));
        assert_eq!(depth(&[("a", &[("B", 5.0), ("G", 5.0), ("R", 5.0)])]), Ok(5.0));
    }

    #[test]
    fn what_may_be_another_channel_is_refused() {
        let two = depth(&[("left", &[("Z", 1.0)]), ("right", &[("Z", 2.0)])]).expect_err("two");
        assert!(two.contains("expected one EXR channel of depth, found Z, Z"), "{two}");
        let colours = depth(&[("a", &[("B", 0.1), ("G", 0.2), ("R", 0.3)])]).expect_err("colours");
        assert!(colours.contains("R, G and B that differ"), "{colours}");
        let none = depth(&[("a", &[("u", 0.1), ("v", 0.2)])]).expect_err("none");
        assert!(none.contains("found u, v"), "{none}");
    }
}

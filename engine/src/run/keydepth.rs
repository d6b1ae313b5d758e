//! Depth of key frames, from files or from a network.

use std::time::Duration;
#[cfg(feature = "onnx")]
use std::time::Instant;

use crate::depth::DepthMaps;
#[cfg(feature = "onnx")]
use crate::depth::DepthNetwork;
use crate::picture::Picture;
use crate::source::Source;
#[cfg(feature = "onnx")]
use crate::stream::Workers;
use streamsplat_kernels::Level;

use crate::run::Error;
use crate::run::options::DepthFrom;

/// Where a frame's depth comes from.
pub enum KeyDepth {
    /// There is none.
    None,
    /// Every frame has a file, which belongs to the input.
    Maps(DepthMaps),
    /// A network estimates the depth of key frames.
    #[cfg(feature = "onnx")]
    Network(Box<Looker>),
}

/// A network, its last input, and its account.
#[cfg(feature = "onnx")]
pub struct Looker {
    network: DepthNetwork,
    /// The latest frame's samples and map: a repeated frame is not evaluated again.
    latest: Option<(Vec<f32>, Vec<f32>)>,
    reuse: bool,
    account: NetworkAccount,
}

/// Work done by a depth network.
#[derive(Clone, Debug, Default)]
pub struct NetworkAccount {
    /// Version of the ONNX Runtime.
    pub runtime: String,
    /// Frames evaluated.
    pub done: u64,
    /// Key frames equal to the one before.
    pub avoided: u64,
    /// Time spent.
    pub time: Duration,
}

impl KeyDepth {
    /// Opens the folder or the network. With `reuse` a frame equal to the key frame before gets its map. The number of
    /// maps is checked against that of the frames, of which at most `limit` are read.
    pub fn open(
        from: &DepthFrom,
        source: &Source,
        level: Level,
        reuse: bool,
        limit: Option<usize>,
    ) -> Result<KeyDepth, Error> {
        Ok(match from {
            DepthFrom::None | DepthFrom::Found | DepthFrom::Guessed => KeyDepth::None,
            DepthFrom::Folder(folder, range, values) => {
                let maps = DepthMaps::open_as(folder, source.files(), *range, *values)?;
                // Maps of image files were matched with them by name.
                match (source.files(), source.frames()) {
                    (Some(_), _) => {}
                    (None, Some(frames)) => maps.check(frames, limit)?,
                    // The number of frames in a file's header may come from its sound track; the check allows for that.
                    (None, None) => source.counted_frames().map_or(Ok(()), |frames| maps.check_about(frames, limit))?,
                }
                KeyDepth::Maps(maps)
            }
            #[cfg(not(feature = "onnx"))]
            DepthFrom::Network(path, _) => {
                let _ = (level, reuse);
                let message = "expected a build with the cargo feature onnx, found one without";
                return Err(Error::usage(format!("--depth onnx:{}: {message}", path.display())));
            }
            #[cfg(feature = "onnx")]
            DepthFrom::Network(path, options) => {
                // One thread, like the network itself: it works in parallel with those of the engine.
                let network = DepthNetwork::open(path, options.clone(), &Workers::new(level, 1)?)?;
                let runtime = network.runtime_version().to_owned();
                let account = NetworkAccount { runtime, ..NetworkAccount::default() };
                KeyDepth::Network(Box::new(Looker { network, latest: None, reuse, account }))
            }
        })
    }

    /// Files that are left out, one per line.
    pub fn notes(&self) -> &[String] {
        match self {
            KeyDepth::Maps(maps) => maps.notes(),
            _ => &[],
        }
    }

    /// Checks that no map is left over after the input ended with `frames` frames.
    pub fn ended(&self, source: &Source, frames: usize) -> Result<(), Error> {
        match self {
            KeyDepth::Maps(maps) if source.files().is_none() => Ok(maps.check(frames, None)?),
            _ => Ok(()),
        }
    }

    /// The map in the frame's file.
    pub fn of_file(&self, index: usize, picture: &Picture) -> Result<Option<Vec<f32>>, Error> {
        match self {
            KeyDepth::Maps(maps) => Ok(Some(maps.map(index, picture.width, picture.height)?)),
            _ => Ok(None),
        }
    }

    /// Returns true for a map of a file without depth to use.
    pub fn is_flat(&self, map: &[f32]) -> bool {
        matches!(self, KeyDepth::Maps(maps) if maps.is_flat(map))
    }

    /// The network's map of a key frame.
    pub fn of_network(&mut self, picture: &Picture) -> Result<Option<Vec<f32>>, Error> {
        #[cfg(feature = "onnx")]
        if let KeyDepth::Network(looker) = self {
            return looker.look(picture).map(Some);
        }
        let _ = picture;
        Ok(None)
    }

    /// Work done by the network; `None` where depth does not come from a network.
    pub fn account(&self) -> Option<NetworkAccount> {
        match self {
            #[cfg(feature = "onnx")]
            KeyDepth::Network(looker) => Some(looker.account.clone()),
            _ => None,
        }
    }
}

#[cfg(feature = "onnx")]
impl Looker {
    fn look(&mut self, picture: &Picture) -> Result<Vec<f32>, Error> {
        let same_bits =
            |a: &[f32], b: &[f32]| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits());
        if let Some((rgb, map)) = &self.latest
            && same_bits(rgb, &picture.rgb)
        {
            self.account.avoided += 1;
            return Ok(map.clone());
        }
        let _span = tracing::info_span!("depth").entered();
        let start = Instant::now();
        let map = self.network.map(&picture.rgb, picture.width, picture.height)?;
        self.account.time += start.elapsed();
        self.account.done += 1;
        self.latest = self.reuse.then(|| (picture.rgb.clone(), map.clone()));
        Ok(map)
    }
}

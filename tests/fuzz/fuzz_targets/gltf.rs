#![no_main]

streamsplat_fuzz::target!("gltf");

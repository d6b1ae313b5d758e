#![no_main]

streamsplat_fuzz::target!("streamed_sog");

#![no_main]

streamsplat_fuzz::target!("model_config");

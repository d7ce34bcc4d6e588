// The page of `cape view --export`, whose model and worker are scripts before this one.

import { openModel } from "./local.js";
import { start } from "./viewer.js";

start(() => openModel(window.capeModel, window.capeWorker));

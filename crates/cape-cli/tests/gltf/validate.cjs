// Runs Khronos' glTF validator on files: node validate.cjs FILE.glb...
// Fails on any error or warning.
const { readFileSync } = require('node:fs');
const validator = require('gltf-validator');

(async () => {
  let failed = process.argv.length < 3;
  for (const path of process.argv.slice(2)) {
    const report = await validator.validateBytes(new Uint8Array(readFileSync(path)));
    const { numErrors, numWarnings, messages } = report.issues;
    console.log(`${path}: ${numErrors} errors, ${numWarnings} warnings, ` +
      `${report.info.totalVertexCount} vertices, ${report.info.animationCount} animations`);
    for (const { severity, code, message, pointer } of messages.slice(0, 20)) {
      if (severity < 2) console.log(`  ${code} at ${pointer}: ${message}`);
    }
    failed ||= numErrors + numWarnings > 0;
  }
  process.exit(failed ? 1 : 0);
})();

"use strict";
// A rater's way through the study; each answer is sent before the next pair is shown.
(async () => {
  const root = document.querySelector("main");
  const { page, pair, feedback, size, INSTRUCTIONS } = window.capeStudy;
  const fail = () => page(root, "The connection was lost", ["Your answers so far are kept. Reload this page to go on."]);

  async function send(where, value) {
    for (let attempt = 0; ; attempt += 1) {
      try {
        const response = await fetch(where, { method: "POST", body: JSON.stringify(value) });
        if (response.ok) return response.json();
        if (response.status === 409) { location.reload(); return new Promise(() => {}); }
        throw new Error(`status ${response.status}`);
      } catch (error) {
        if (attempt === 3) throw error;
        await new Promise((wait) => setTimeout(wait, 500 * 2 ** attempt));
      }
    }
  }

  try {
    const plan = await (await fetch("plan.json")).json();
    if (plan.next === 0) {
      await page(root, "A study of clothing", plan.consent, "I agree, begin");
      await send("event", { event: "consent", window: size(), agent: navigator.userAgent });
      await page(root, "How it works", INSTRUCTIONS, "Start practice");
    }
    for (let index = plan.next; index < plan.trials.length; index += 1) {
      const { left, right, number, count, practice } = plan.trials[index];
      if (!practice && number === 1 && index > 0) {
        await page(root, "Practice is over", [`From now on you are not told the answer. ${count} pairs follow.`], "Begin");
      }
      // The next pictures are loaded ahead.
      const ahead = plan.trials[index + 1];
      if (ahead) for (const file of [ahead.left, ahead.right]) new Image().src = `stimuli/${file}`;
      const answer = await pair(root, { left: `stimuli/${left}`, right: `stimuli/${right}`, number, count, practice });
      const { correct } = await send("answer", { index, ...answer });
      if (practice) await feedback(root, correct);
    }
    await page(root, "Thank you", ["All answers are saved. You can close this page."]);
    if (plan.completion) location.assign(plan.completion);
  } catch (error) {
    await fail();
  }
})();

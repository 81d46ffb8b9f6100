// What a sentence asks for, as query/sentences.py reads it. Its patterns come from there, with the page.

export interface SentenceRules {
  related: string; strange: string; asking: string; there: string; article: string; number: string; not: string; posed: string; but_not: string;
  here: string[]; colors: string[]; tones: Record<string, string>;
}

/** Return the words that are looked for. Throws where a sentence tells how things lie: a page does not know that. */
export function parsed(text: string, rules: SentenceRules): string {
  const whole = text.split(/\s+/).filter(Boolean).join(" ").replace(/[?.! ]+$/, ""), lower = whole.toLowerCase();
  const asking = new RegExp(rules.asking).exec(lower), counting = new RegExp(rules.number).test(lower), found = (pattern: string, words: string) => new RegExp(pattern).exec(words.toLowerCase());
  let said = asking ? whole.slice(asking[0].length).replace(new RegExp(rules.there), "") : whole;
  said = said.replace(new RegExp(rules.not, "g"), ", not ");
  const thing = (words: string) => words.replace(/^[ ,]+|[ ,]+$/g, "").replace(new RegExp(rules.article, "i"), "").replace(new RegExp(rules.number), "");
  const strange = found(rules.strange, said), related = found(rules.related, said);
  if (strange && said.slice(strange.index + strange[0].length).trim()) throw lies(strange[0]);
  if (!related) return asking || counting ? thing(said) : said;
  const place = said.slice(related.index + related[0].length).replace(/^[ ,]+|[ ,]+$/g, "");
  if (!(said.slice(0, related.index).trim() || asking || new RegExp(rules.article, "i").test(place))) return said;
  const [after, ...unwanted] = place.replace(new RegExp(rules.article, "i"), "").split(/(?=, not )/);
  const before = said.slice(0, related.index).replace(new RegExp(rules.posed), "") + unwanted.join("");
  const first = after.toLowerCase().split(" ")[0];
  if (!after || rules.colors.includes(after.toLowerCase()) || Object.hasOwn(rules.tones, after.toLowerCase()) || rules.here.includes(first)) {
    return rules.here.includes(after.toLowerCase()) || asking ? thing(before) : said;
  }
  throw lies(related[0]);
}

function lies(word: string): Error { return new Error(`“${word}”: how things lie to each other, this page does not know. Ask for the things one by one, such as “mug; table”; drsplat locate answers “mug on the table”.`); }

/** Split "mug, not red" into what is wanted and what is not. */
export function splitNegation(text: string, rules: SentenceRules): [string, string[]] {
  const [wanted, ...unwanted] = text.split(new RegExp(rules.but_not, "i")).map((part) => part.trim());
  if (unwanted.length && ![wanted, ...unwanted].every(Boolean)) throw new Error(`“${text}”: expected words and their exclusions, as in “mug, not red”.`);
  return [wanted, unwanted];
}

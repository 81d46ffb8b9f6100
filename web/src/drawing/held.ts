// What painters are given.

/** What a painter needs of a pose, as plain numbers that can be sent to a worker. */
export interface Lens { eye: number[]; rows: number[]; focal: number; width: number; height: number }

/** A scene as painters hold it: float32 places, float32 covariances (xx xy xz yy yz zz). */
export interface Held { count: number; centers: Float32Array; covariances: Float32Array; rgba: Uint8Array; antialiased: boolean }

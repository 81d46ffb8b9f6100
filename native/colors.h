// View-dependent colour from spherical harmonics, degree 0-3, with the 3DGS sign convention:
// max(0, 0.5 + sum_k c_k Y_k(d)), d the unit direction from the camera to the Gaussian.
#pragma once

// F is float, or Floats for sixteen directions at once.
template <class F>
static inline int sh_basis(F x, F y, F z, int coefficients, F *Y) {
  Y[0] = constant<F>(0.28209479177387814f);
  if (coefficients <= 1) return 1;
  const float c1 = 0.4886025119029199f;
  Y[1] = -c1 * y, Y[2] = c1 * z, Y[3] = -c1 * x;
  if (coefficients <= 4) return 4;
  const F xx = x * x, yy = y * y, zz = z * z;
  Y[4] = 1.0925484305920792f * (x * y);
  Y[5] = -1.0925484305920792f * (y * z);
  Y[6] = 0.31539156525252005f * (2.f * zz - xx - yy);
  Y[7] = -1.0925484305920792f * (x * z);
  Y[8] = 0.5462742152960396f * (xx - yy);
  if (coefficients <= 9) return 9;
  Y[9] = -0.5900435899266435f * (y * (3.f * xx - yy));
  Y[10] = 2.890611442640554f * (x * y * z);
  Y[11] = -0.4570457994644658f * (y * (4.f * zz - xx - yy));
  Y[12] = 0.3731763325901154f * (z * (2.f * zz - 3.f * xx - 3.f * yy));
  Y[13] = -0.4570457994644658f * (x * (4.f * zz - xx - yy));
  Y[14] = 1.445305721320277f * (z * (xx - yy));
  Y[15] = -0.5900435899266435f * (x * (xx - 3.f * yy));
  return 16;
}

static void sh_colors(const float *sh, int32_t coefficients, const float *means, const float *center, uint32_t begin, uint32_t end, float *colors) {
  for (uint32_t i = begin; i < end; i++) {
    float d[3], Y[16], color[3] = {0.5f, 0.5f, 0.5f};
    for (int a = 0; a < 3; a++) d[a] = means[3 * (size_t)i + a] - center[a];
    const float norm = __builtin_sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]), scale = norm > 0 ? 1.f / norm : 0.f;
    const int n = sh_basis(d[0] * scale, d[1] * scale, d[2] * scale, coefficients, Y);
    const float *row = sh + (size_t)i * coefficients * 3;
    for (int k = 0; k < n; k++)
      for (int c = 0; c < 3; c++) color[c] += Y[k] * row[3 * k + c];
    for (int c = 0; c < 3; c++) colors[3 * (size_t)i + c] = color[c] > 0 ? color[c] : 0.f;
  }
}

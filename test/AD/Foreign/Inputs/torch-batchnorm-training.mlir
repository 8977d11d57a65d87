// Row: torch | batch normalisation with moments of the batch, three results
#id = affine_map<(n, c) -> (n, c)>
#ch = affine_map<(n, c) -> (c)>
#one = affine_map<(c) -> (c)>
func.func @f(%x: tensor<5x3xf32>, %gamma: tensor<3xf32>) -> (tensor<5x3xf32>, tensor<3xf32>, tensor<3xf32>) attributes {tai.differentiate} {
  %zero = arith.constant 0.0 : f32
  %eps = arith.constant 1.0e-3 : f32
  %five = arith.constant 5.0 : f32
  %e = tensor.empty() : tensor<3xf32>
  %z = linalg.fill ins(%zero : f32) outs(%e : tensor<3xf32>) -> tensor<3xf32>
  %s = linalg.generic {indexing_maps = [#id, #ch], iterator_types = ["reduction", "parallel"]} ins(%x : tensor<5x3xf32>) outs(%z : tensor<3xf32>) {
  ^bb0(%in: f32, %o: f32):
    %t = arith.addf %in, %o : f32
    linalg.yield %t : f32
  } -> tensor<3xf32>
  %mean = linalg.generic {indexing_maps = [#one, #one], iterator_types = ["parallel"]} ins(%s : tensor<3xf32>) outs(%e : tensor<3xf32>) {
  ^bb0(%in: f32, %o: f32):
    %t = arith.divf %in, %five : f32
    linalg.yield %t : f32
  } -> tensor<3xf32>
  %var = linalg.generic {indexing_maps = [#id, #ch, #ch], iterator_types = ["reduction", "parallel"]} ins(%x, %mean : tensor<5x3xf32>, tensor<3xf32>) outs(%z : tensor<3xf32>) {
  ^bb0(%in: f32, %m: f32, %o: f32):
    %d = arith.subf %in, %m : f32
    %q = arith.mulf %d, %d : f32
    %w = arith.divf %q, %five : f32
    %t = arith.addf %w, %o : f32
    linalg.yield %t : f32
  } -> tensor<3xf32>
  %b = tensor.empty() : tensor<5x3xf32>
  %r = linalg.generic {indexing_maps = [#id, #ch, #ch, #ch, #id], iterator_types = ["parallel", "parallel"]} ins(%x, %mean, %var, %gamma : tensor<5x3xf32>, tensor<3xf32>, tensor<3xf32>, tensor<3xf32>) outs(%b : tensor<5x3xf32>) {
  ^bb0(%in: f32, %m: f32, %v: f32, %g: f32, %o: f32):
    %d = arith.subf %in, %m : f32
    %ve = arith.addf %v, %eps : f32
    %i = math.rsqrt %ve : f32
    %t = arith.mulf %d, %i : f32
    %u = arith.mulf %t, %g : f32
    linalg.yield %u : f32
  } -> tensor<5x3xf32>
  return %r, %mean, %var : tensor<5x3xf32>, tensor<3xf32>, tensor<3xf32>
}

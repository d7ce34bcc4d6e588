;; Matrix products of single precision, row-major, with SIMD.
(module
  (memory (export "memory") 1)

  ;; out = a b with a [m, k], b [k, n] and out [m, n] for m >= 4, in all columns but the last n % 4.
  ;; Four rows by four columns at a time, whose sums stay in registers.
  (func (export "blocks")
    (param $a i32) (param $b i32) (param $out i32) (param $m i32) (param $k i32) (param $n i32)
    (local $width i32) (local $step i32) (local $column i32) (local $row i32) (local $first i32)
    (local $p0 i32) (local $p1 i32) (local $p2 i32) (local $p3 i32) (local $end i32) (local $q i32)
    (local $y v128) (local $s0 v128) (local $s1 v128) (local $s2 v128) (local $s3 v128)
    ;; Bytes of a row of a, and of b and out.
    (local.set $width (i32.shl (local.get $k) (i32.const 2)))
    (local.set $step (i32.shl (local.get $n) (i32.const 2)))
    (block $done
      (loop $columns
        (br_if $done (i32.gt_u (i32.add (local.get $column) (i32.const 16)) (local.get $step)))
        (local.set $row (i32.const 0))
        (loop $rows
          ;; The last four of other than a multiple of four rows overlap those before.
          (local.set $first (i32.sub (local.get $m) (i32.const 4)))
          (local.set $first (select (local.get $row) (local.get $first)
            (i32.lt_u (local.get $row) (local.get $first))))
          (local.set $p0 (i32.add (local.get $a) (i32.mul (local.get $first) (local.get $width))))
          (local.set $p1 (i32.add (local.get $p0) (local.get $width)))
          (local.set $p2 (i32.add (local.get $p1) (local.get $width)))
          (local.set $p3 (i32.add (local.get $p2) (local.get $width)))
          (local.set $end (local.get $p1))
          (local.set $q (i32.add (local.get $b) (local.get $column)))
          (local.set $s0 (v128.const i32x4 0 0 0 0))
          (local.set $s1 (v128.const i32x4 0 0 0 0))
          (local.set $s2 (v128.const i32x4 0 0 0 0))
          (local.set $s3 (v128.const i32x4 0 0 0 0))
          (loop $terms
            (local.set $y (v128.load align=4 (local.get $q)))
            (local.set $s0 (f32x4.add (local.get $s0)
              (f32x4.mul (v128.load32_splat (local.get $p0)) (local.get $y))))
            (local.set $s1 (f32x4.add (local.get $s1)
              (f32x4.mul (v128.load32_splat (local.get $p1)) (local.get $y))))
            (local.set $s2 (f32x4.add (local.get $s2)
              (f32x4.mul (v128.load32_splat (local.get $p2)) (local.get $y))))
            (local.set $s3 (f32x4.add (local.get $s3)
              (f32x4.mul (v128.load32_splat (local.get $p3)) (local.get $y))))
            (local.set $q (i32.add (local.get $q) (local.get $step)))
            (local.set $p1 (i32.add (local.get $p1) (i32.const 4)))
            (local.set $p2 (i32.add (local.get $p2) (i32.const 4)))
            (local.set $p3 (i32.add (local.get $p3) (i32.const 4)))
            (local.set $p0 (i32.add (local.get $p0) (i32.const 4)))
            (br_if $terms (i32.lt_u (local.get $p0) (local.get $end))))
          (local.set $q (i32.add (i32.add (local.get $out) (local.get $column))
            (i32.mul (local.get $first) (local.get $step))))
          (v128.store align=4 (local.get $q) (local.get $s0))
          (local.set $q (i32.add (local.get $q) (local.get $step)))
          (v128.store align=4 (local.get $q) (local.get $s1))
          (local.set $q (i32.add (local.get $q) (local.get $step)))
          (v128.store align=4 (local.get $q) (local.get $s2))
          (local.set $q (i32.add (local.get $q) (local.get $step)))
          (v128.store align=4 (local.get $q) (local.get $s3))
          (local.set $row (i32.add (local.get $row) (i32.const 4)))
          (br_if $rows (i32.lt_u (local.get $row) (local.get $m))))
        (local.set $column (i32.add (local.get $column) (i32.const 16)))
        (br $columns))))

  ;; out = a b of a row a [k], with b [k, n] and out [n]. Rows of b for zeros of a are passed over.
  (func (export "row")
    (param $a i32) (param $b i32) (param $out i32) (param $k i32) (param $n i32)
    (local $end i32) (local $to i32) (local $stop i32) (local $factor f32) (local $x v128)
    (local.set $n (i32.shl (local.get $n) (i32.const 2)))
    (local.set $end (i32.add (local.get $a) (i32.shl (local.get $k) (i32.const 2))))
    (local.set $stop (i32.add (local.get $out) (local.get $n)))
    (memory.fill (local.get $out) (i32.const 0) (local.get $n))
    (loop $terms
      (local.set $factor (f32.load (local.get $a)))
      (if (f32.eq (local.get $factor) (f32.const 0))
        (then (local.set $b (i32.add (local.get $b) (local.get $n))))
        (else
          (local.set $x (f32x4.splat (local.get $factor)))
          (local.set $to (local.get $out))
          (block $whole
            (loop $columns
              (br_if $whole (i32.gt_u (i32.add (local.get $to) (i32.const 16)) (local.get $stop)))
              (v128.store align=4 (local.get $to) (f32x4.add (v128.load align=4 (local.get $to))
                (f32x4.mul (local.get $x) (v128.load align=4 (local.get $b)))))
              (local.set $to (i32.add (local.get $to) (i32.const 16)))
              (local.set $b (i32.add (local.get $b) (i32.const 16)))
              (br $columns)))
          (block $rest
            (loop $columns
              (br_if $rest (i32.ge_u (local.get $to) (local.get $stop)))
              (f32.store (local.get $to) (f32.add (f32.load (local.get $to))
                (f32.mul (local.get $factor) (f32.load (local.get $b)))))
              (local.set $to (i32.add (local.get $to) (i32.const 4)))
              (local.set $b (i32.add (local.get $b) (i32.const 4)))
              (br $columns)))))
      (local.set $a (i32.add (local.get $a) (i32.const 4)))
      (br_if $terms (i32.lt_u (local.get $a) (local.get $end))))))
